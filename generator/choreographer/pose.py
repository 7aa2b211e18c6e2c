"""A body over time while it is being built: frames and points, filled from the pelvis outwards."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.choreographer.footsteps import Foot
from generator.choreographer.role import Role
from generator.choreographer.style import Side
from generator.kinematics import continuous, forward_kinematics, to_wxyz
from generator.motion import Motion
from robots.skeleton import FloatArray


class Pose:
    """World frames and positions of one person's keypoints.

    Attributes:
        role: What the person does.
        points: ``[T, J, 3]`` m, valid for every keypoint whose parent has its frame.
        frames: ``[T, J, 3, 3]``, rest frame to world.
        feet: Paths of the feet.
    """

    def __init__(self, role: Role, feet: dict[Side, Foot]) -> None:
        """Start with no frame set."""
        skeleton = role.build.skeleton
        self.role = role
        self.feet = feet
        self.points = np.zeros((len(role.times), len(skeleton), 3))
        self.frames = np.tile(np.eye(3), (len(role.times), len(skeleton), 1, 1))
        self._children: list[list[int]] = [[] for _ in skeleton.names]
        for child, parent in enumerate(skeleton.parents):
            if parent >= 0:
                self._children[parent].append(child)

    def point(self, name: str) -> FloatArray:
        """Return the path ``[T, 3]`` m of a keypoint."""
        return self.points[:, self.role.build.skeleton.index(name)]

    def frame(self, name: str) -> FloatArray:
        """Return the world rotations ``[T, 3, 3]`` of a keypoint."""
        return self.frames[:, self.role.build.skeleton.index(name)]

    def turn(self, name: str, rotation: NDArray) -> None:
        """Give a keypoint its world rotations ``[T, 3, 3]`` and place its children."""
        skeleton = self.role.build.skeleton
        index = skeleton.index(name)
        self.frames[:, index] = rotation
        for child in self._children[index]:
            self.points[:, child] = self.points[:, index] + rotation @ skeleton.offsets[child]

    def motion(self, fps: float) -> Motion:
        """Return the finished motion; its keypoints are the kinematics of its rotations."""
        skeleton = self.role.build.skeleton
        parents = list(skeleton.parents)
        local = self.frames.copy()
        local[:, 1:] = np.swapaxes(self.frames[:, parents[1:]], -1, -2) @ self.frames[:, 1:]
        quaternions = to_wxyz(Rotation.from_matrix(local.reshape(-1, 3, 3)))
        rotations = continuous(quaternions.reshape(*local.shape[:2], 4))
        keypoints = forward_kinematics(skeleton, self.points[:, 0], rotations)
        left, right = self.feet["left"], self.feet["right"]
        contacts = np.column_stack([left.heel_down, left.toe_down, right.heel_down, right.toe_down])
        return Motion(fps, keypoints, rotations, contacts, skeleton)
