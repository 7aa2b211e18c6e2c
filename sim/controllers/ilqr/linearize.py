"""Derivatives of one step of physics.

The state is the position in tangent space and the velocity, ``x = (dq [nv], v [nv])``; the input is
``ctrl [nu]``.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from robots.skeleton import FloatArray

_STEP, _WIDE_STEP = 1e-5, 3e-4
"""Perturbations of finite differences; the wide one is for states on the edge of a contact."""
_BOUND = 1000.0
"""Largest entry that a step without a jump produces."""


class Linearizer:
    """Derivatives of one step of a model about states, on one thread. Not thread-safe: one each."""

    def __init__(self, model: Any, *, exact: bool = False) -> None:
        """Prepare for a model.

        Args:
            model: ``mujoco.MjModel`` of one person.
            exact: Difference every column in full.
        """
        self._model = model
        self._exact = exact

    def __call__(self, data: Any, A: FloatArray, B: FloatArray) -> bool:
        """Write the derivatives of the next state by state and input.

        Args:
            data: ``mujoco.MjData`` at the state, with ``ctrl``, mocap poses and
                ``qacc_warmstart`` set. State, inputs and warm start are as before on return.
            A: ``[2 nv, 2 nv]``, C-contiguous, gets ``dx'/dx``.
            B: ``[2 nv, nu]``, C-contiguous, gets ``dx'/du``.

        Returns:
            Whether the derivatives are as differenced; False if an entry was over 1000, so that
            they had to be taken again over a wider step and clipped.
        """
        mujoco.mjd_transitionFD(self._model, data, _STEP, False, A, B, None, None)
        if np.abs(A).max() <= _BOUND:
            return True
        mujoco.mjd_transitionFD(self._model, data, _WIDE_STEP, True, A, B, None, None)
        np.clip(np.nan_to_num(A, copy=False), -_BOUND, _BOUND, out=A)
        np.clip(np.nan_to_num(B, copy=False), -_BOUND, _BOUND, out=B)
        return False
