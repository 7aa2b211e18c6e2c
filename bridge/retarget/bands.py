"""Least squares over time: accelerations as bands, and the block-banded equations they lead to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from robots.skeleton import FloatArray

_STENCIL = (1.0, -2.0, 1.0)


def second_difference_bands(
    acceleration: NDArray, count: int
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]:
    """Return diagonal and two lower bands of ``D' D``, and the gradient ``D' a``.

    ``D`` is the ``[count - 2, count]`` matrix of second differences: row i is 1, -2, 1 at columns
    i, i + 1, i + 2.

    Args:
        acceleration: ``[count - 2, nv]``, the second differences ``a`` as they are.
        count: Number of frames.

    Returns:
        Bands ``[count]`` (band k holds entry ``(i + k, i)`` at i, 0 behind the end), and the
        gradient ``[count, nv]``.
    """
    bands = tuple(np.zeros(count) for _ in _STENCIL)
    gradient = np.zeros((count, acceleration.shape[1]))
    rows = max(count - 2, 0)
    for i, left in enumerate(_STENCIL):
        gradient[i : i + rows] += left * acceleration
        for k in range(len(_STENCIL) - i):
            bands[k][i : i + rows] += left * _STENCIL[i + k]
    return (bands[0], bands[1], bands[2]), gradient


def solve_blocks(blocks: NDArray, below: NDArray, far: NDArray, right: NDArray) -> FloatArray:
    """Return x of ``A x = right`` for a positive definite block-pentadiagonal ``A``.

    A Cholesky factorisation block by block. A general banded solver does the same arithmetic, but
    hands work of this size to many threads, which wait for each other on a busy machine.

    Args:
        blocks: ``[T, n, n]``, blocks on the diagonal.
        below: ``[T, n]``, row t the diagonal of block ``(t + 1, t)``; the last is not looked at.
        far: ``[T, n]``, row t the diagonal of block ``(t + 2, t)``; the last two are not.
        right: ``[T, n]``.

    Raises:
        numpy.linalg.LinAlgError: ``A`` is not positive definite.
    """
    count, n = right.shape
    dpotrf, dtrtri = get_lapack_funcs(("potrf", "trtri"), dtype=np.float64)
    # A = L L'. Kept per row t: the inverse of L(t, t), and L(t, t - 1), L(t, t - 2).
    inverse = np.zeros((count, n, n))
    near, wide = np.zeros((count, n, n)), np.zeros((count, n, n))
    forward = np.zeros((count, n))
    for t in range(count):
        block, value = blocks[t], right[t]
        if t >= 2:
            wide[t] = far[t - 2][:, None] * inverse[t - 2].T
            block = block - wide[t] @ wide[t].T
            value = value - wide[t] @ forward[t - 2]
        if t >= 1:
            link = np.diag(below[t - 1]) - wide[t] @ near[t - 1].T
            near[t] = link @ inverse[t - 1].T
            block = block - near[t] @ near[t].T
            value = value - near[t] @ forward[t - 1]
        factor, failed = dpotrf(block, lower=1)
        if failed:
            raise np.linalg.LinAlgError(f"block {t} is not positive definite")
        inverse[t] = np.tril(dtrtri(factor, lower=1)[0])
        forward[t] = inverse[t] @ value
    out = np.zeros((count, n))
    for t in range(count - 1, -1, -1):
        value = forward[t].copy()
        if t + 1 < count:
            value -= near[t + 1].T @ out[t + 1]
        if t + 2 < count:
            value -= wide[t + 2].T @ out[t + 2]
        out[t] = inverse[t].T @ value
    return out
