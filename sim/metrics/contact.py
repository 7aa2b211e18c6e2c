"""Whether hands that were meant to meet do meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from generator.motion import LEFT_HAND, RIGHT_HAND, Contact
from robots.skeleton import FloatArray, Skeleton

TOLERANCE = 0.05
"""Further apart than intended by this much, m, still counts as touching."""


def point_path(keypoints: NDArray, skeleton: Skeleton, name: str) -> FloatArray:
    """Return the path ``[N, 3]`` m of a keypoint or a hand (see :meth:`Motion.point`)."""
    if name in (LEFT_HAND, RIGHT_HAND):
        side = name.removesuffix("_hand")
        elbow = keypoints[:, skeleton.index(f"{side}_elbow")]
        wrist = keypoints[:, skeleton.index(f"{side}_wrist")]
        return wrist + (wrist - elbow) * skeleton.hand_per_forearm
    return keypoints[:, skeleton.index(name)]


def gap(keypoints: NDArray, skeletons: tuple[Skeleton, Skeleton], a: str, b: str) -> FloatArray:
    """Return the distance ``[N]`` m between a point of a and a point of b."""
    one = point_path(keypoints[:, 0], skeletons[0], a)
    return np.linalg.norm(one - point_path(keypoints[:, 1], skeletons[1], b), axis=1)


def wanted_and_met(
    times: NDArray,
    keypoints: NDArray,
    reference: NDArray,
    skeletons: tuple[Skeleton, Skeleton],
    labels: Sequence[Contact],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return, per moment and wanted touch ``[N, C]``, whether it is wanted and whether it happens.

    A labelled touch is wanted within its window, and happens where the simulated distance is within
    :data:`TOLERANCE` of what was intended (or of what the reference itself reached, if that is
    further). Without labels, every pair of hands is wanted where the reference has them closer than
    the tolerance. Recall is the share of wanted moments in which it happens; as contact recall in
    two-person tracking, tolerance 2 to 5 cm.

    Args:
        times: ``[N]`` s.
        keypoints: ``[N, 2, J, 3]`` m, simulated.
        reference: ``[N, 2, J, 3]`` m.
        skeletons: Of a and b.
        labels: Intended touches; may be empty.
    """
    wanted, met = [], []
    if labels:
        for contact in labels:
            asked = gap(reference, skeletons, contact.a, contact.b)
            got = gap(keypoints, skeletons, contact.a, contact.b)
            wanted.append((times >= contact.start) & (times <= contact.end))
            met.append(got <= np.maximum(asked, contact.gap) + TOLERANCE)
    else:
        for a, b in product((LEFT_HAND, RIGHT_HAND), repeat=2):
            asked = gap(reference, skeletons, a, b)
            wanted.append(asked < TOLERANCE)
            met.append(gap(keypoints, skeletons, a, b) <= asked + TOLERANCE)
    return np.stack(wanted, axis=1), np.stack(met, axis=1)
