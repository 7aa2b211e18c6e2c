"""Takes jolts out of a motion: moments in which a keypoint's velocity changes as no body's does.

**The problem.** What a network draws is smooth nearly everywhere, and now and then a hip is turned
round in one frame, or a foot is thrown. Noise filters (:mod:`generator.finishing.denoise`) keep
such a jolt, because it is far above the noise, and filters that would take it out would blunt all
accents. So only the moments around a jolt are smoothed, wider from round to round, until the
velocity changes there as it does in people.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from generator.finishing.figure import Figure
from generator.kinematics import continuous
from generator.motion import Motion
from robots.skeleton import FloatArray, Skeleton

_ROUNDS = 8
_WIDTH, _WIDER = 0.04, 0.02
"""Standard deviation of the smoothing in the first round, and how much more in each other, s."""
_AROUND = 2.0
"""How far from a jolt it is smoothed, in standard deviations."""


def calm(
    skeleton: Skeleton, root: NDArray, rotations: NDArray, fps: float, jolt: float
) -> tuple[FloatArray, FloatArray]:
    """Return root ``[T, 3]`` m and rotations ``[T, J, 4]`` wxyz without jolts.

    Args:
        skeleton: The body.
        root: ``[T, 3]`` m.
        rotations: ``[T, J, 4]`` wxyz.
        fps: Frames per second.
        jolt: Change of velocity that is one, m/s^2.
    """
    root, rotations = np.array(root, dtype=float), continuous(rotations)
    for number in range(_ROUNDS):
        jolted = _jolted(Figure(skeleton, root, rotations).points, fps, jolt)
        if not jolted.any():
            break
        width = (_WIDTH + number * _WIDER) * fps
        reach = max(1, round(_AROUND * width))
        near = maximum_filter1d(jolted.astype(float), 2 * reach + 1, mode="nearest")
        share = gaussian_filter1d(near, 0.5 * reach, mode="nearest")
        root += share[:, None] * (gaussian_filter1d(root, width, axis=0, mode="nearest") - root)
        smooth = gaussian_filter1d(rotations, width, axis=0, mode="nearest")
        rotations += share[:, None, None] * (smooth - rotations)
        rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    return root, rotations


def calmed(motion: Motion, jolt: float) -> Motion:
    """Return a motion that has rotations without jolts; planting feet makes some, for one."""
    if motion.rotations is None or not _jolted(motion.keypoints, motion.fps, jolt).any():
        return motion
    root, turns = calm(motion.skeleton, motion.keypoints[:, 0], motion.rotations, motion.fps, jolt)
    points = Figure(motion.skeleton, root, turns).points
    return Motion(motion.fps, points, turns, motion.foot_contacts, motion.skeleton)


def _jolted(points: NDArray, fps: float, jolt: float) -> NDArray[np.bool_]:
    """Return when ``[T]`` the velocity of some keypoint changes too much."""
    change = np.zeros(len(points))
    if len(points) > 2:
        bend = np.diff(points, 2, axis=0) * fps**2
        change[1:-1] = np.linalg.norm(bend, axis=-1).max(axis=1)
    return change > jolt
