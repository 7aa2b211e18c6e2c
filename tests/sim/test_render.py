"""Pictures and videos, drawn for real with whatever offscreen OpenGL is here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest

from robots.errors import MotionFileError, RenderError
from sim.camera import follow, still
from sim.clip import Clip
from sim.render import PERSON_COLOURS, Painter, colour_people, dress
from sim.video import write_picture, write_video

PILLARS = """<mujoco><worldbody><geom name="floor" type="plane" size="9 9 .1"/>
  <body name="a/trunk" pos="-.6 0 .8"><freejoint/><geom type="capsule" size=".15 .6"/></body>
  <body name="b/trunk" pos=".6 0 .8"><freejoint/><geom type="capsule" size=".15 .6"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def clip() -> Clip:
    spec = colour_people(dress(mujoco.MjSpec.from_string(PILLARS), width=96, height=96))
    model = spec.compile()
    qpos = np.tile(model.qpos0, (20, 1))
    qpos[:, 1] += np.linspace(0, 0.4, 20)
    return Clip(model, qpos, 20.0)


@pytest.fixture
def painter(clip: Clip):
    try:
        with Painter(clip.model, width=96, height=96) as opened:
            yield opened
    except RenderError as error:
        pytest.skip(f"no offscreen OpenGL here: {error}")


def pixels_like(frame: np.ndarray, colour: tuple[float, ...]) -> np.ndarray:
    """Columns of the pixels whose hue is that of a colour."""
    hue = frame - frame.mean(axis=-1, keepdims=True)
    wanted = np.array(colour[:3]) - np.mean(colour[:3])
    cosine = hue @ wanted / (np.linalg.norm(hue, axis=-1) * np.linalg.norm(wanted) + 1e-9)
    return np.nonzero((cosine > 0.9) & (np.linalg.norm(hue, axis=-1) > 40))[1]


@pytest.mark.gl
def test_person_a_stands_left_and_b_right_and_both_are_seen(clip: Clip, painter: Painter) -> None:
    frame = painter.paint(clip.qpos[0], clip.camera(aspect=1.0), 0)
    a, b = (pixels_like(frame, colour) for colour in PERSON_COLOURS)
    assert len(a) > 100
    assert len(b) > 100
    assert a.max() < b.min()
    assert a.min() > 2
    assert b.max() < 93


@pytest.mark.gl
def test_video_has_every_frame_at_the_stated_rate(
    clip: Clip, painter: Painter, tmp_path: Path
) -> None:
    path = tmp_path / "video.mp4"
    count = write_video(path, painter.film(clip.qpos, clip.camera(aspect=1.0)), clip.fps)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.average_rate == 20
        assert stream.codec_context.pix_fmt == "yuv420p"
    assert count == len(frames) == len(clip.qpos)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


@pytest.mark.gl
def test_picture_is_the_frame_to_the_last_bit(clip: Clip, painter: Painter, tmp_path: Path) -> None:
    frame = painter.paint(clip.qpos[3], clip.camera(aspect=1.0), 3)
    write_picture(tmp_path / "p.png", frame)
    with av.open(str(tmp_path / "p.png")) as container:
        (read,) = container.decode(video=0)
    assert np.array_equal(read.to_ndarray(format="rgb24"), frame)


def test_a_video_that_fails_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="at least one frame"):
        write_video(tmp_path / "video.mp4", iter(()), 30)
    assert list(tmp_path.iterdir()) == []


def test_a_video_into_a_forbidden_place_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MotionFileError, match="cannot be written"):
        write_video(tmp_path / "file" / "video.mp4", iter(()), 30)


def test_camera_keeps_walkers_in_view_however_far_they_go() -> None:
    t = np.linspace(0, 8, 240)
    path = np.stack([1.2 * t, 0 * t, 0 * t], axis=-1)[:, None]
    corners = np.array([[-0.3, -0.3, 0], [0.3, 0.3, 1.8]])
    a, b = path + corners, path + corners + [0.0, -1.0, 0.0]
    camera = follow(a, b, fps=30, aspect=1.0, fovy=45.0)
    right, up, sight = camera.axes()
    eyes = np.stack([camera.eye(i) for i in range(len(t))])
    seen = np.concatenate([a, b], axis=1) - eyes[:, None]
    depth = seen @ sight
    reach = np.tan(np.radians(45 / 2))
    assert (np.abs(seen @ right) < depth * reach).all()
    assert (np.abs(seen @ up) < depth * reach).all()
    assert np.linalg.norm(np.diff(camera.centre, axis=0), axis=1).max() * 30 < 1.5


def test_clip_changes_rate_without_losing_its_ends(clip: Clip) -> None:
    slow = clip.at_rate(10)
    assert len(slow.qpos) == 10
    assert np.array_equal(slow.qpos[0], clip.qpos[0])
    assert np.array_equal(slow.qpos[-1], clip.qpos[18])


def test_still_camera_has_one_moment() -> None:
    assert still().centre.shape == (1, 3)


def test_without_opengl_the_reason_is_one_line_and_names_the_remedy() -> None:
    code = (
        "import mujoco\n"
        "from robots.errors import RenderError\n"
        "from sim.render import Painter\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "try: Painter(model, width=8, height=8)\n"
        "except RenderError as error: print(error)\n"
    )
    env = os.environ | {"MUJOCO_GL": "disable"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith("there is no offscreen OpenGL; install")
    assert done.stdout.count("\n") == 1
    assert "Traceback" not in done.stderr


def test_a_screen_backend_without_a_screen_is_an_error_and_no_abort() -> None:
    """MuJoCo's default renderer took the whole process down when it was imported before ours."""
    code = (
        "import mujoco\n"
        "from robots.errors import RenderError\n"
        "from sim.render import Painter\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "try: Painter(model, width=8, height=8)\n"
        "except RenderError as error: print(error)\n"
    )
    env = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    env["MUJOCO_GL"] = "glfw"
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    if sys.platform.startswith("linux"):
        assert "there is none" in done.stdout
