"""How far the joints of people bend, by keypoints."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray, Skeleton

RANGES: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "spine1": ("spine2", 100.0),
        "spine2": ("spine3", 100.0),
        "spine3": ("neck", 100.0),
        "neck": ("head", 100.0),
        "left_elbow": ("left_wrist", 165.0),
        "right_elbow": ("right_wrist", 165.0),
        "left_knee": ("left_ankle", 165.0),
        "right_knee": ("right_ankle", 165.0),
    }
)
"""Largest angle, degrees, between the bone that ends at a keypoint and the one on to the next.

People bend their whole lumbar spine by about 60 degrees and fold knees and elbows to 150 (American
Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and Recording", 1965). Keypoints
do not lie in the joints: in captured people who bow deep, spine1 and spine2 reach 70 degrees each.
"""


def bones_at(
    keypoints: NDArray, skeleton: Skeleton, name: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the bones before and after a joint of :data:`RANGES`, and the angle between them.

    Args:
        keypoints: ``[..., J, 3]`` m.
        skeleton: Names and parents of the keypoints.
        name: Of the joint.

    Returns:
        Two vectors ``[..., 3]`` m and ``[...]`` degrees, 0 where the limb is straight.
    """
    j, child = skeleton.index(name), skeleton.index(RANGES[name][0])
    before = keypoints[..., j, :] - keypoints[..., skeleton.parents[j], :]
    after = keypoints[..., child, :] - keypoints[..., j, :]
    lengths = np.linalg.norm(before, axis=-1) * np.linalg.norm(after, axis=-1)
    cosine = (before * after).sum(axis=-1) / np.maximum(lengths, 1e-9)
    return before, after, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
