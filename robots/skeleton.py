"""The human skeleton: 22 keypoints, their parents and their rest offsets.

*Keypoint* means a point of the human body; *joint* is kept for the degrees of freedom of robots.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from robots.errors import SpecError, nearest

FloatArray = NDArray[np.float64]


def read_only(array: NDArray, dtype: type = np.float64) -> NDArray:
    """Return a read-only copy of ``array``, so that frozen types are frozen all the way down."""
    copy = np.array(array, dtype=dtype, order="C")
    copy.setflags(write=False)
    return copy


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """A tree of keypoints with rest offsets.

    Raises:
        SpecError: Lengths differ, a parent does not precede its child, or an offset is not finite.
    """

    names: tuple[str, ...]
    """Keypoint names, in the order in which arrays carry them."""
    parents: tuple[int, ...]
    """Index of each keypoint's parent; -1 for the root, which comes first."""
    offsets: FloatArray
    """``[J, 3]`` m, from the parent, in the rest frame: x forward, y left, z up, T-pose."""
    hand_per_forearm: float = 0.3206
    """Distance from wrist to the middle knuckle, as a share of the forearm (de Leva 1996)."""
    _index: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Validate and freeze."""
        object.__setattr__(self, "offsets", read_only(self.offsets))
        object.__setattr__(self, "_index", {n: i for i, n in enumerate(self.names)})
        count = len(self.names)
        if len(self._index) != count or len(self.parents) != count:
            raise SpecError("skeleton needs one parent per uniquely named keypoint")
        if self.offsets.shape != (count, 3) or not np.isfinite(self.offsets).all():
            raise SpecError(f"skeleton offsets must be finite with shape ({count}, 3)")
        if self.parents[:1] != (-1,) or any(
            not 0 <= p < i for i, p in enumerate(self.parents) if i
        ):
            raise SpecError("skeleton keypoints must come after their parents, root first")

    def __len__(self) -> int:
        """Return the number of keypoints."""
        return len(self.names)

    def index(self, name: str) -> int:
        """Return the position of a keypoint in arrays.

        Raises:
            SpecError: There is no such keypoint.
        """
        try:
            return self._index[name]
        except KeyError:
            raise SpecError(
                f"no keypoint '{name}'", allowed=", ".join(self.names), hint=nearest(name, self)
            ) from None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self.names)

    @property
    def bone_lengths(self) -> FloatArray:
        """``[J]`` m, length of the bone from each keypoint's parent; 0 for the root."""
        return np.linalg.norm(self.offsets, axis=1)

    def with_bone_lengths(self, lengths: NDArray) -> Skeleton:
        """Return this skeleton with every bone set to the given length ``[J]`` m."""
        own = self.bone_lengths
        scale = np.divide(lengths, own, out=np.ones_like(own), where=own > 0)
        return Skeleton(
            self.names, self.parents, self.offsets * scale[:, None], self.hand_per_forearm
        )

    def scaled(self, factor: float) -> Skeleton:
        """Return this skeleton with all offsets multiplied by ``factor``."""
        return Skeleton(self.names, self.parents, self.offsets * factor, self.hand_per_forearm)


@cache
def human_skeleton() -> Skeleton:
    """Return the project's 22-keypoint human of 1.70 m (``robots/human/skeleton.toml``)."""
    text = resources.files("robots").joinpath("human/skeleton.toml").read_text("utf-8")
    data = tomllib.loads(text)
    points = data["keypoint"]
    names = tuple(p["name"] for p in points)
    parents = tuple(names.index(p["parent"]) if "parent" in p else -1 for p in points)
    return Skeleton(
        names, parents, np.array([p["offset"] for p in points]), data["hand_per_forearm"]
    )
