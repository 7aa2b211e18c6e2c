"""Look at a clip in a web browser: live, or as one HTML file that plays without a server.

Needs the extra ``view`` (viser and mjviser).
"""

from __future__ import annotations

import io
import threading
import time
from contextlib import redirect_stdout
from typing import Any

import mujoco

from robots.errors import RenderError
from sim.clip import Clip


def _scene(clip: Clip, host: str, port: int) -> tuple[Any, Any]:
    try:
        import mjviser
        import viser
    except ImportError as error:
        raise RenderError(
            "the browser viewer is not installed", hint="pip install 'pasdedeux[view]'"
        ) from error
    try:
        with redirect_stdout(io.StringIO()):  # its banner
            server = viser.ViserServer(host=host, port=port, verbose=False)
    except OSError as error:
        raise RenderError(
            f"port {port} cannot be opened: {error}", where=host, hint="choose another with --port"
        ) from error
    scene = mjviser.ViserMujocoScene(server, clip.model, num_envs=1)
    camera = clip.camera(aspect=1.5)
    server.initial_camera.look_at = tuple(camera.centre[0])
    server.initial_camera.position = tuple(camera.eye(0))
    return server, scene


def html(clip: Clip) -> str:
    """Return a self-contained HTML page that plays the clip with a timeline.

    Raises:
        RenderError: The viewer is not installed or does not start.
    """
    server, scene = _scene(clip, "127.0.0.1", 0)
    try:
        serializer = server.get_scene_serializer()
        data = mujoco.MjData(clip.model)
        for pose in clip.qpos:
            data.qpos[:] = pose
            mujoco.mj_forward(clip.model, data)
            scene.update_from_mjdata(data)
            serializer.insert_sleep(1.0 / clip.fps)
        return serializer.as_html()
    finally:
        _close(server)


def _close(server: Any) -> None:
    with redirect_stdout(io.StringIO()):  # its farewell
        server.stop()


class Viewer:
    """A web page that plays a clip in a loop, with a slider, pause and speed.

    Raises:
        RenderError: The viewer is not installed, or the port is taken.
    """

    def __init__(self, clip: Clip, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Open the page; it shows the first frame until :meth:`play` runs."""
        self._clip = clip
        self._data = mujoco.MjData(clip.model)
        self._server, self._scene = _scene(clip, host, port)
        gui = self._server.gui
        if clip.title:
            gui.add_markdown(f"**{clip.title}**")
        last = len(clip.qpos) - 1
        self._playing = gui.add_checkbox("play", initial_value=True)
        self._speed = gui.add_slider("speed", min=0.1, max=2.0, step=0.1, initial_value=1.0)
        self._frame = gui.add_slider("frame", min=0, max=last, step=1, initial_value=0)
        self._frame.on_update(lambda _: self._draw(int(self._frame.value)))
        self._draw(0)

    @property
    def address(self) -> str:
        """What to type into the browser."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def _draw(self, index: int) -> None:
        self._data.qpos[:] = self._clip.qpos[index]
        mujoco.mj_forward(self._clip.model, self._data)
        self._scene.update_from_mjdata(self._data)

    def play(self, stop: threading.Event) -> None:
        """Play until ``stop`` is set, then close the page."""
        now = time.monotonic()
        phase = 0.0
        try:
            while not stop.wait(1.0 / 60.0):
                previous, now = now, time.monotonic()
                if not self._playing.value:
                    phase = float(self._frame.value)
                    continue
                phase += (now - previous) * self._speed.value * self._clip.fps
                phase %= len(self._clip.qpos)
                if int(phase) != self._frame.value:
                    self._frame.value = int(phase)  # its callback draws
        finally:
            _close(self._server)
