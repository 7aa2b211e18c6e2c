"""Which OpenGL draws offscreen.

MuJoCo decides at its import, from the environment variable ``MUJOCO_GL``, and fails at import if
the chosen library is missing. So the choice is made here, before, from the libraries present.
"""

from __future__ import annotations

import ctypes.util
import os
import sys


def choose_backend() -> str:
    """Set ``MUJOCO_GL`` if the user has not, and return it (empty: MuJoCo's own default).

    On Linux: EGL (needs no screen), else OSMesa (software), else ``disable``, so that everything
    but pictures works. Elsewhere MuJoCo's default draws offscreen as it is. Call it before the
    first ``import mujoco``; later calls change nothing.
    """
    chosen = os.environ.get("MUJOCO_GL")
    if chosen is not None:
        return chosen
    if not sys.platform.startswith("linux"):
        return ""
    if ctypes.util.find_library("EGL"):
        backend = "egl"
    elif ctypes.util.find_library("OSMesa"):
        backend = "osmesa"
    else:
        backend = "disable"
    os.environ["MUJOCO_GL"] = backend
    if backend in ("egl", "osmesa"):
        os.environ.setdefault("PYOPENGL_PLATFORM", backend)
    return backend
