"""The non-canonical representation (Sec. 4.1, eq. 2): 262 numbers per person and frame.

    x = [ positions 22*3 | displacements 22*3 | local rotations 21*6 | foot contacts 4 ]

Positions are metres, displacements metres *per frame* (not per second), both in one world frame for
the two people; rotations are local to the parent, in the rest frames of SMPL and without the root;
contacts are 0 or 1 for left ankle, left toe, right ankle, right toe. The six numbers of a rotation
matrix R are ``R[:, :2].reshape(6)``: r00, r01, r10, r11, r20, r21.

**Axes.** The representation is y-up: x left, y up, z forward, as SMPL's rest frames are. The rest
of the project is z-up: x forward, y left. One cyclic permutation leads from one to the other, for
the world and for the rest frames alike, and it stands here and nowhere else.

**What the encoding drops.** The last frame (it has no displacement). Where the pair stands: person
a's pelvis starts above the origin with the hips facing +z, and person b keeps its place relative to
person a. The height of the floor: the lowest keypoint of *both* people over all frames lies at
zero. A :class:`Placement` keeps the last two, so that :func:`decode` can restore them. The root's
orientation is found again from hips and spine.

The public release takes each person's own lowest keypoint as the floor, which sets a lifted partner
down; ``release_compat=True`` does so too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.architecture import FEATURES
from generator.io.assembly import fit_body
from generator.kinematics import fit_rotations, from_wxyz, to_wxyz
from generator.motion import DuetMotion, Motion
from generator.placement import Placement, placement_of
from robots.errors import MotionError
from robots.skeleton import FloatArray, Skeleton, read_only

POINTS = 22
"""Keypoints per person."""
LOCAL_ROTATIONS = POINTS - 1
"""Keypoints whose local rotation is stored: all but the root."""

POSITIONS = slice(0, 3 * POINTS)
VELOCITIES = slice(3 * POINTS, 6 * POINTS)
ROTATIONS = slice(6 * POINTS, 6 * POINTS + 6 * LOCAL_ROTATIONS)
CONTACTS = slice(FEATURES - 4, FEATURES)

RELEASE_WIDTH = 492
"""Columns of ``motions_processed``: 62 points x 3 and 51 rotations x 6, body before hands."""
LOADED_WIDTH = 192
"""Columns of it that are used: 22 points and 21 rotations."""

_TO_Y_UP = (1, 2, 0)
_TO_Z_UP = (2, 0, 1)

CONTACT_POINTS = (7, 10, 8, 11)
"""Left ankle, left toe, right ankle, right toe: :data:`generator.motion.CONTACT_POINTS`."""
CONTACT_STEP = 0.001
"""Squared displacement below which a foot is at rest, m^2 at 30 frames per second."""
CONTACT_HEIGHTS = (0.12, 0.05, 0.12, 0.05)
"""Height below which the point can touch the floor, m."""
_CONTACT_FPS = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """One person's motion in the axes of the representation, before it is put into place.

    Raises:
        MotionError: The arrays do not belong together or are not finite.
    """

    positions: FloatArray
    """``[T, 22, 3]`` m, y-up world."""
    rotations: FloatArray
    """``[T, 21, 6]`` local rotations in SMPL's rest frames, root left out."""
    contacts: FloatArray | None = None
    """``[T, 4]`` foot contacts, 0 or 1, where the source labels them."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        frames = len(self.positions)
        expected: dict[str, tuple[int, ...]] = {
            "positions": (frames, POINTS, 3),
            "rotations": (frames, LOCAL_ROTATIONS, 6),
        }
        if self.contacts is not None:
            expected["contacts"] = (frames, len(CONTACT_POINTS))
        for name, shape in expected.items():
            array = np.asarray(getattr(self, name))
            if array.shape != shape:
                raise MotionError(f"{name} have shape {array.shape}", allowed=str(shape))
            if not np.isfinite(array).all():
                raise MotionError(f"{name} are not finite")
            object.__setattr__(self, name, read_only(array))

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.positions)

    def cut(self, start: int, stop: int) -> Poses:
        """Return frames ``start`` up to before ``stop``."""
        contacts = None if self.contacts is None else self.contacts[start:stop]
        return Poses(self.positions[start:stop], self.rotations[start:stop], contacts)


def to_sixd(matrices: NDArray) -> FloatArray:
    """Return ``[..., 6]``, the first two columns of rotation matrices, read row by row."""
    return matrices[..., :, :2].reshape(*matrices.shape[:-2], 6)


def from_sixd(sixd: NDArray) -> FloatArray:
    """Return rotation matrices ``[..., 3, 3]`` nearest (Gram-Schmidt) to ``[..., 6]``.

    Numbers that span no plane, such as six zeros, give the identity.
    """
    columns = np.asarray(sixd, float).reshape(*sixd.shape[:-1], 3, 2)
    first, second = columns[..., 0], columns[..., 1]
    length = np.linalg.norm(first, axis=-1, keepdims=True)
    x = first / np.maximum(length, 1e-12)
    second = second - x * (x * second).sum(-1, keepdims=True)
    height = np.linalg.norm(second, axis=-1, keepdims=True)
    y = second / np.maximum(height, 1e-12)
    matrices = np.stack([x, y, np.cross(x, y)], axis=-1)
    flat = (length < 1e-8) | (height < 1e-8)
    return np.where(flat[..., None], np.eye(3), matrices)


def poses_of(motion: Motion) -> Poses:
    """Return a person's motion in the axes of the representation.

    Rotations are fitted where the motion has none.
    """
    rotations = motion.rotations
    if rotations is None:
        rotations = fit_rotations(motion.skeleton, motion.keypoints)
    matrices = from_wxyz(rotations[:, 1:].reshape(-1, 4)).as_matrix()
    matrices = matrices[:, _TO_Y_UP][:, :, _TO_Y_UP].reshape(-1, LOCAL_ROTATIONS, 3, 3)
    contacts = None if motion.foot_contacts is None else motion.foot_contacts.astype(float)
    return Poses(motion.keypoints[..., _TO_Y_UP], to_sixd(matrices), contacts)


def loaded_columns(array: NDArray) -> FloatArray:
    """Return the used columns ``[T, 192]`` of an InterHuman array ``[T, 492]`` (or of themselves).

    Raises:
        MotionError: It has another width.
    """
    array = np.asarray(array, float)
    if array.ndim == 2 and array.shape[1] == RELEASE_WIDTH:
        return np.concatenate([array[:, :66], array[:, 186:312]], axis=1)
    if array.ndim == 2 and array.shape[1] == LOADED_WIDTH:
        return array
    raise MotionError(
        f"InterHuman rows have shape {array.shape}",
        allowed=f"(frames, {RELEASE_WIDTH}) or (frames, {LOADED_WIDTH})",
    )


def release_poses(array: NDArray) -> Poses:
    """Return the poses of an InterHuman array ``[T, 492]`` or ``[T, 192]`` (z-up, SMPL rest).

    Raises:
        MotionError: It has another width or is not finite.
    """
    columns = loaded_columns(array)
    x, y, z = np.moveaxis(columns[:, :66].reshape(-1, POINTS, 3), -1, 0)
    return Poses(np.stack([x, z, -y], axis=-1), columns[:, 66:].reshape(-1, LOCAL_ROTATIONS, 6))


def lowest(*people: Poses) -> float:
    """Return the height of the lowest keypoint of one or more people, m."""
    return min(float(person.positions[..., 1].min()) for person in people)


def person_features(poses: Poses, placement: Placement, fps: float = _CONTACT_FPS) -> FloatArray:
    """Return the features ``[T-1, 262]`` of one person in a given canonical frame.

    Args:
        poses: The motion.
        placement: The frame; its floor is where height is measured from.
        fps: Frames per second; the threshold of the foot contacts is a speed.
    """
    positions = placement.apply(poses.positions)
    steps = np.diff(positions, axis=0)
    contacts = poses.contacts
    labels = foot_contacts(positions, fps) if contacts is None else contacts[:-1]
    rows = poses.frames - 1
    return np.concatenate(
        [
            positions[:-1].reshape(rows, -1),
            steps.reshape(rows, -1),
            poses.rotations[:-1].reshape(rows, -1),
            labels,
        ],
        axis=1,
    )


def foot_contacts(positions: NDArray, fps: float) -> FloatArray:
    """Return contact labels ``[T-1, 4]``, 0 or 1, of ``positions [T, 22, 3]`` m with floor at 0.

    A foot touches where it is low and moves slower than about 0.95 m/s. These are the release's
    loose thresholds; a swinging foot passes them only at its turning points.
    """
    feet = positions[:, CONTACT_POINTS]
    step = (np.diff(feet, axis=0) ** 2).sum(axis=-1)
    still = step < CONTACT_STEP * (_CONTACT_FPS / fps) ** 2
    return (still & (feet[:-1, :, 1] < CONTACT_HEIGHTS)).astype(float)


def pair_features(
    pair: Sequence[Poses],
    fps: float,
    *,
    canonical: Literal[0, 1] = 0,
    floor: float | None = None,
    release_compat: bool = False,
) -> FloatArray:
    """Return the features ``[T-1, 2, 262]`` of two people, in their order.

    Args:
        pair: Two motions of equal length.
        fps: Frames per second.
        canonical: Which of the two starts at the origin and faces +z.
        floor: Height of the floor, m; the pair's lowest keypoint by default.
        release_compat: Measure each person from its own lowest keypoint and derive the contacts
            from thresholds, as the release does.

    Raises:
        MotionError: The two differ in length, or have fewer than two frames.
    """
    frames = pair[0].frames
    if frames != pair[1].frames or frames < 2:
        raise MotionError(
            f"{frames} and {pair[1].frames} frames", allowed="equal numbers, 2 or more"
        )
    base = lowest(*pair) if floor is None else floor
    out = []
    for person in pair:
        if release_compat:
            person, base = Poses(person.positions, person.rotations), lowest(person)
        out.append(person_features(person, placement_of(pair[canonical].positions, base), fps))
    return np.stack(out, axis=1)


def release_features(
    person1: NDArray, person2: NDArray, *, canonical: Literal[0, 1] = 0
) -> tuple[FloatArray, FloatArray]:
    """Return what the public release makes of two InterHuman arrays ``[T, 492]`` or ``[T, 192]``.

    Args:
        person1: First person's file, z-up.
        person2: Second person's.
        canonical: Which of the two is at the origin; the release draws it.

    Returns:
        Two arrays ``[T-1, 262]``, in the order of the arguments.

    Raises:
        MotionError: An array has another width or length, or is not finite.
    """
    pair = (release_poses(person1), release_poses(person2))
    both = pair_features(pair, _CONTACT_FPS, canonical=canonical, release_compat=True)
    return both[:, 0], both[:, 1]


def pair_placement(motion: DuetMotion) -> Placement:
    """Return the canonical frame of a pair: what :func:`encode` drops and :func:`decode` takes."""
    points = motion.keypoints[..., _TO_Y_UP]
    return placement_of(points[:1, 0], float(points[..., 1].min()))


def encode(motion: DuetMotion, *, release_compat: bool = False) -> FloatArray:
    """Return the features ``[T-1, 2, 262]`` of a motion, at its own frame rate.

    Args:
        motion: Two people.
        release_compat: As in :func:`pair_features`.
    """
    pair = [poses_of(person) for person in motion.people]
    return pair_features(pair, motion.fps, release_compat=release_compat)


def decode(
    features: NDArray,
    fps: float,
    *,
    placement: Placement | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
    rotations: Literal["fitted", "features"] = "fitted",
    text: str = "",
    seed: int | None = None,
    source: str = "",
    licence: str = "",
) -> DuetMotion:
    """Return the motion that features stand for.

    Keypoints are taken as they are, displacements are not needed.

    Args:
        features: ``[N, 2, 262]`` or ``[N, 524]`` with person a first, de-normalised, N >= 2.
        fps: Frames per second they were made for.
        placement: Where the pair stands; by default person a starts at the world's origin and
            faces +x, and the floor is at 0.
        skeletons: Bodies of a and b; fitted to the keypoints by default.
        rotations: ``fitted`` derives the local rotations from the keypoints, which agrees with
            them by construction. ``features`` keeps the stored ones, which know the twist of
            bones but, in a generated motion, need not agree.
        text: Kept in the motion.
        seed: Kept in the motion.
        source: Kept in the motion.
        licence: Kept in the motion.

    Raises:
        MotionError: The shape does not fit, there are too few frames, or a number is not finite.
    """
    features = np.asarray(features, float)
    if features.ndim not in (2, 3) or features.shape[1:] not in ((2, FEATURES), (2 * FEATURES,)):
        raise MotionError(
            f"features have shape {features.shape}",
            allowed=f"(frames, 2, {FEATURES}) or (frames, {2 * FEATURES})",
        )
    if not np.isfinite(features).all():
        raise MotionError("features are not finite")
    both = features.reshape(len(features), 2, FEATURES)
    where = placement or Placement(0.0, (0.0, 0.0, 0.0))
    given = skeletons or (None, None)
    a, b = (_person(both[:, i], fps, where, given[i], rotations) for i in range(2))
    return DuetMotion(a, b, text=text, seed=seed, source=source, licence=licence)


def _person(
    features: FloatArray,
    fps: float,
    placement: Placement,
    skeleton: Skeleton | None,
    rotations: Literal["fitted", "features"],
) -> Motion:
    positions = placement.undo(features[:, POSITIONS].reshape(-1, POINTS, 3))
    points = positions[..., _TO_Z_UP]
    contacts = features[:, CONTACTS] > 0.5
    if len(points) < 2:
        raise MotionError(f"{len(points)} frames of features", allowed="2 or more")
    if skeleton is None:
        skeleton, pose = fit_body(points)
    else:
        pose = fit_rotations(skeleton, points)
    if rotations == "features":
        matrices = from_sixd(features[:, ROTATIONS].reshape(-1, LOCAL_ROTATIONS, 6))
        matrices = matrices[..., _TO_Z_UP, :][..., _TO_Z_UP]
        pose[:, 1:] = to_wxyz(Rotation.from_matrix(matrices.reshape(-1, 3, 3))).reshape(
            -1, LOCAL_ROTATIONS, 4
        )
    return Motion(fps, points, pose, contacts, skeleton)
