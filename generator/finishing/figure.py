"""A body over time while it is being mended: bends that carry along what hangs on them."""

from __future__ import annotations

from copy import copy
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.kinematics import continuous, to_wxyz
from generator.motion import Motion
from robots.skeleton import FloatArray, Skeleton


class Figure:
    """Points and frames of one person, always those of the skeleton: bones keep their lengths.

    Attributes:
        skeleton: Rest offsets.
        points: ``[T, J, 3]`` m, world.
        frames: ``[T, J, 3, 3]``, rest frame to world.
    """

    def __init__(self, skeleton: Skeleton, root: NDArray, rotations: NDArray) -> None:
        """Start from a pose over time.

        Args:
            skeleton: Rest offsets.
            root: ``[T, 3]`` m.
            rotations: ``[T, J, 4]`` wxyz, root to world and others local to the parent.
        """
        self.skeleton = skeleton
        frames = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_matrix()
        self.frames = frames.reshape(*rotations.shape[:2], 3, 3)
        self.points = np.empty((*rotations.shape[:2], 3))
        self.points[:, 0] = root
        for j, parent in enumerate(skeleton.parents[1:], start=1):
            above = self.frames[:, parent]
            self.points[:, j] = self.points[:, parent] + above @ skeleton.offsets[j]
            self.frames[:, j] = above @ self.frames[:, j]

    def __len__(self) -> int:
        """Return the number of frames T."""
        return len(self.points)

    def copy(self) -> Figure:
        """Return the same body, to be changed on its own."""
        other = copy(self)
        other.points, other.frames = self.points.copy(), self.frames.copy()
        return other

    def point(self, name: str) -> FloatArray:
        """Return the path ``[T, 3]`` m of a keypoint or of ``left_hand`` / ``right_hand``."""
        if name.endswith("_hand"):
            side = name.removesuffix("_hand")
            elbow, wrist = self.point(f"{side}_elbow"), self.point(f"{side}_wrist")
            return wrist + (wrist - elbow) * self.skeleton.hand_per_forearm
        return self.points[:, self.skeleton.index(name)]

    def frame(self, name: str) -> FloatArray:
        """Return the world rotations ``[T, 3, 3]`` of a keypoint."""
        return self.frames[:, self.skeleton.index(name)]

    def shift(self, offset: NDArray) -> None:
        """Move the whole body by ``[T, 3]`` m."""
        self.points += offset[:, None]

    def bend(self, name: str, turn: NDArray) -> None:
        """Turn a keypoint and all that hangs on it by rotations ``[T, 3, 3]`` in the world."""
        index = self.skeleton.index(name)
        below = list(_descendants(self.skeleton.parents, index))
        pivot = self.points[:, index : index + 1]
        turned = (self.points[:, below] - pivot) @ np.swapaxes(turn, -1, -2)
        self.points[:, below] = pivot + turned
        self.frames[:, below] = turn[:, None] @ self.frames[:, below]

    def motion(self, fps: float, foot_contacts: NDArray | None) -> Motion:
        """Return the motion as it is now."""
        parents = list(self.skeleton.parents[1:])
        local = self.frames.copy()
        local[:, 1:] = np.swapaxes(self.frames[:, parents], -1, -2) @ self.frames[:, 1:]
        quaternions = to_wxyz(Rotation.from_matrix(local.reshape(-1, 3, 3)))
        rotations = continuous(quaternions.reshape(*local.shape[:2], 4))
        return Motion(fps, self.points, rotations, foot_contacts, self.skeleton)


@cache
def _descendants(parents: tuple[int, ...], index: int) -> tuple[int, ...]:
    """Return a keypoint and all keypoints that hang on it."""
    below = {index}
    for child, parent in enumerate(parents):
        if parent in below:
            below.add(child)
    return tuple(sorted(below))


def turn_about(vectors: NDArray) -> FloatArray:
    """Return the matrices ``[T, 3, 3]`` of rotation vectors ``[T, 3]`` rad."""
    return Rotation.from_rotvec(vectors).as_matrix()
