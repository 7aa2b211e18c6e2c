"""Pictures of a MuJoCo scene without a screen and without a GPU.

Primitive geoms, no shadows, no reflections: that is 60 times faster in software rendering than
MuJoCo's defaults on meshes, so that ten seconds of duet draw in seconds on two cores.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.errors import RenderError
from robots.skeleton import FloatArray
from sim.camera import CameraPath

log = logging.getLogger(__name__)

Frame = NDArray[np.uint8]
"""``[height, width, 3]`` RGB."""

PERSON_COLOURS = ((0.91, 0.45, 0.32, 1.0), (0.25, 0.55, 0.80, 1.0))
"""Body colours of a (coral) and b (blue)."""

_NO_GL = (
    "install an offscreen OpenGL (Debian: apt-get install libegl1 libgl1-mesa-dri) or set"
    " MUJOCO_GL=osmesa"
)


def dress(spec: Any, *, width: int, height: int, floor_tile: float = 0.5) -> Any:
    """Give a scene what only a picture needs: sky, tiled floor, lights, a big enough canvas.

    Geoms are left as they are, so that ``qpos`` of the undressed model fits the dressed one.

    Args:
        spec: A ``mujoco.MjSpec``; changed in place and returned.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
        floor_tile: Edge of a floor tile, m.
    """
    world = spec.worldbody
    scale = getattr(spec.visual, "global_", None) or getattr(spec.visual, "global")
    scale.offwidth, scale.offheight = max(width, 1), max(height, 1)
    spec.visual.quality.offsamples = 0  # smooth edges would take three times as long
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 18, 10
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    spec.add_texture(
        name="picture/sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.96, 0.97, 0.98],
        rgb2=[0.78, 0.83, 0.88],
        width=64,
        height=64 * 6,
    )
    spec.add_texture(
        name="picture/tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_NONE,
        rgb1=[0.86, 0.87, 0.88],
        rgb2=[0.80, 0.82, 0.84],
        width=256,
        height=256,
    )
    material = spec.add_material(name="picture/floor", texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "picture/tiles"
    material.texrepeat = [0.5 / floor_tile, 0.5 / floor_tile]
    material.specular, material.shininess = 0.0, 0.0
    for geom in world.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.material = "picture/floor"
            geom.rgba = [1.0, 1.0, 1.0, 1.0]
    for direction in ((0.4, 0.6, -1.0), (-0.7, -0.4, -0.8)):
        world.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 4.0],
            dir=direction,
            diffuse=[0.32, 0.32, 0.32],
            specular=[0.1, 0.1, 0.1],
            castshadow=False,
        )
    return spec


def colour_people(spec: Any, prefixes: tuple[str, str] = ("a/", "b/")) -> Any:
    """Colour the geoms of two prefixed bodies, so that a and b can be told apart; returns spec."""
    for body in spec.bodies:
        for prefix, colour in zip(prefixes, PERSON_COLOURS, strict=True):
            if body.name.startswith(prefix):
                for geom in body.geoms:
                    geom.rgba = colour
    return spec


class Painter:
    """Draws poses of one model. Use as a context manager, so that OpenGL is let go in order.

    Raises:
        RenderError: There is no OpenGL that draws offscreen.
    """

    def __init__(self, model: Any, *, width: int, height: int) -> None:
        """Open an offscreen canvas of ``width`` by ``height`` pixels for a ``mujoco.MjModel``."""
        self._model = model
        self._data = mujoco.MjData(model)
        _require_backend()
        try:
            self._renderer = mujoco.Renderer(model, height=height, width=width)
        except AttributeError as error:  # MuJoCo was imported without a backend
            raise RenderError("there is no offscreen OpenGL", hint=_NO_GL) from error
        except Exception as error:  # each backend fails in its own way
            raise RenderError(f"OpenGL does not start: {error}", hint=_NO_GL) from error
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0

    def __enter__(self) -> Painter:
        """Return self."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of OpenGL."""
        self._renderer.close()

    def paint(self, qpos: NDArray, camera: CameraPath, index: int) -> Frame:
        """Return the picture of one pose ``[nq]`` through the camera at moment ``index``."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._camera.lookat[:] = camera.centre[index]
        self._camera.azimuth = camera.azimuth
        self._camera.elevation = camera.elevation
        self._camera.distance = camera.distance[index]
        self._renderer.update_scene(self._data, self._camera)
        return self._renderer.render()

    def film(self, qpos: NDArray, camera: CameraPath) -> Iterator[Frame]:
        """Yield the pictures of poses ``[N, nq]``."""
        for index in range(len(qpos)):
            yield self.paint(qpos[index], camera, index)


def _require_backend() -> None:
    """Refuse to draw where MuJoCo would abort the whole process instead of raising.

    Its default on Linux, GLFW, needs a screen; without one its renderer ends in ``abort()``.

    Raises:
        RenderError: MuJoCo was imported with that default and there is no screen.
    """
    backend = getattr(getattr(mujoco, "GLContext", None), "__module__", "")
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and backend == "mujoco.glfw" and not screen:
        raise RenderError(
            "MuJoCo was imported for a screen, and there is none",
            hint="set MUJOCO_GL=egl, or call sim.gl.choose_backend() before importing mujoco",
        )


def body_points(model: Any, qpos: NDArray, prefix: str) -> FloatArray:
    """Return world positions ``[N, K, 3]`` m of all bodies whose name starts with ``prefix``."""
    data = mujoco.MjData(model)
    ids = [i for i in range(model.nbody) if model.body(i).name.startswith(prefix)]
    points = np.empty((len(qpos), len(ids), 3))
    for t in range(len(qpos)):
        data.qpos[:] = qpos[t]
        mujoco.mj_kinematics(model, data)
        points[t] = data.xpos[ids]
    return points
