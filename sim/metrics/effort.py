"""What holds people up: the helping hand, and the muscles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.scene import GRAVITY

Bodies = tuple[HumanBody, HumanBody]


def force_share(wrench: NDArray, bodies: Bodies) -> FloatArray:
    """Return the size of forces ``[N, 2]`` as a share of body weight.

    ``|F| / (m g)`` over the vertical and both horizontal components. Of the assist wrench: the
    force that no muscle and no floor gave (Yuan and Kitani, "Residual Force Control", NeurIPS
    2020). Of the residual wrench of inverse dynamics: the force that no floor could give.

    Args:
        wrench: ``[N, 2, 6]`` force N and torque N m.
        bodies: Persons a and b.
    """
    weights = np.array([b.weight * GRAVITY for b in bodies])
    return np.linalg.norm(wrench[..., :3], axis=-1) / weights


def torque_share(wrench: NDArray, bodies: Bodies) -> FloatArray:
    """Return the size of torques ``[N, 2]`` as a share of body weight times stature.

    ``|M| / (m g h)`` over the three components of ``wrench [N, 2, 6]``.
    """
    scale = np.array([b.weight * GRAVITY * b.stature for b in bodies])
    return np.linalg.norm(wrench[..., 3:], axis=-1) / scale


def effort_ratio(torque: NDArray, bodies: Bodies) -> FloatArray:
    """Return the torque of the hardest working joint ``[N, 2]`` over its limit.

    ``max_j |tau_j| / limit_j`` with the limits of ``robots/human/body.toml``.

    Args:
        torque: ``[N, 2, J-1]`` N m.
        bodies: Persons a and b.
    """
    limits = np.array([[b.effort(n) for n in b.skeleton.names[1:]] for b in bodies])
    return (torque / limits).max(axis=-1)
