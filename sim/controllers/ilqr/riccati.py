"""The backward pass: gains and steps that solve the linear-quadratic problem along a plan.

**The problem.** With 138 states and 63 controls, the textbook recursion ``Q = S' V S`` over dense
``S = [A B]`` is a quarter of a plan's cost. But only half of ``S`` is information. The position
follows from the new velocity, ``q' = q exp(h v')``, so with ``C = dv'/d(q, v, u)`` ``[nv, 2 nv +
nu]``::

    S = [G; I] C + [T 0 0; 0 0 0]        G = dq'/dv', T = dq'/dq; both block diagonal

and ``S' V S`` needs products with ``C`` alone, half as many. Single precision halves them once
more: the derivatives are no better than that, and a control Hessian that comes out as not positive
is done again in double precision before anything else is tried.

Notation: Tassa, Erez, Todorov (IROS 2012), eq. 5 and 6, with regularisation of the controls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from robots.skeleton import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics:
    """Linear dynamics along a plan of H knots."""

    change: list[NDArray[np.float32]]
    """H of ``[nv, 2 nv + nu]``: the new velocity by position, velocity and control."""
    by_velocity: NDArray[np.float32]
    """``[H, nv, nv]``: the new position by the new velocity."""
    by_position: NDArray[np.float32]
    """``[H, nv, nv]``: the new position by the old one."""

    def clipped(self, bound: float) -> Dynamics:
        """Return the same with every entry of the velocity's change at most a bound."""
        change = [np.clip(c, -bound, bound) for c in self.change]
        return Dynamics(change, self.by_velocity, self.by_position)


@dataclass(frozen=True, slots=True, eq=False)
class Quadratic:
    """Cost along a plan, to second order about its path."""

    gradient: FloatArray
    """``[H+1, 2 nv]`` of the states; that of the first is not used."""
    hessian: NDArray[np.float32]
    """``[H+1, 2, nv, nv]``: of positions, and of velocities."""
    control: FloatArray
    """``[nu]``: diagonal of the Hessian of the controls."""
    control_gradient: FloatArray
    """``[H, nu]``."""


def riccati(
    dynamics: Dynamics, cost: Quadratic, regularisation: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return gains and steps, in single precision if that will do.

    Args:
        dynamics: Along the plan.
        cost: Along the plan.
        regularisation: Added to the diagonal of the Hessian of the controls.

    Returns:
        Gains ``[H, nu, 2 nv]`` and steps ``[H, nu]``, or ``None`` if the Hessian of the controls is
        not positive definite somewhere.
    """
    for precision in (np.float32, np.float64):
        solved = _sweep(dynamics, cost, regularisation, precision)
        if solved is not None:
            return solved
    return None


def _sweep(
    dynamics: Dynamics, cost: Quadratic, regularisation: float, precision: type
) -> tuple[FloatArray, FloatArray] | None:
    H, nu, n = len(dynamics.change), len(cost.control), cost.gradient.shape[1]
    nv = n // 2
    gains, steps = np.empty((H, nu, n)), np.empty((H, nu))
    g = cost.gradient[H].astype(precision)
    V = np.zeros((n, n), precision)
    V[:nv, :nv], V[nv:, nv:] = cost.hessian[H]
    diagonal = np.diag_indices(nu)
    wanted = np.empty((nu, n + 1), precision)
    for h in range(H - 1, -1, -1):
        C = dynamics.change[h].astype(precision, copy=False)
        G = dynamics.by_velocity[h].astype(precision, copy=False)
        T = dynamics.by_position[h].astype(precision, copy=False)
        W = V[:, :nv] @ G + V[:, nv:]
        both = C.T @ ((G.T @ W[:nv] + W[nv:]) @ C)
        cross = (T.T @ W[:nv]) @ C
        both[:nv] += cross
        both[:, :nv] += cross.T
        both[:nv, :nv] += T.T @ V[:nv, :nv] @ T
        along = C.T @ (G.T @ g[:nv] + g[nv:])
        along[:nv] += T.T @ g[:nv]
        quu = both[n:, n:]
        quu[diagonal] += cost.control + regularisation
        wanted[:, :n], wanted[:, n] = both[n:, :n], along[n:] + cost.control_gradient[h]
        root = _inverse_root(quu)
        if root is None:
            return None
        half = root @ wanted  # quu = L L', root = inverse of L
        solution = root.T @ half
        gains[h], steps[h] = -solution[:, :n], -solution[:, n]
        g = along[:n] - half[:, :n].T @ half[:, n]
        V = both[:n, :n] - half[:, :n].T @ half[:, :n]
        V = 0.5 * (V + V.T)
        if h > 0:
            g += cost.gradient[h]
            V[:nv, :nv] += cost.hessian[h, 0]
            V[nv:, nv:] += cost.hessian[h, 1]
    return gains, steps


def _inverse_root(matrix: NDArray) -> NDArray | None:
    """Return the inverse of the lower Cholesky factor; ``None`` if not positive definite."""
    factorise, invert = _LAPACK[matrix.dtype.char]
    factor, bad = factorise(matrix, lower=True, clean=True)
    if bad:
        return None
    root, bad = invert(factor, lower=True, overwrite_c=True)
    return None if bad or not np.isfinite(root).all() else root


_LAPACK: dict[str, Any] = {
    kind: get_lapack_funcs(("potrf", "trtri"), dtype=np.dtype(kind)) for kind in "fd"
}
