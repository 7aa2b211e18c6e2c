"""The losses of the denoiser (Sec. 4.3): in the paper's form, and as the public release has them.

:func:`interaction_losses` follows the paper and is the default. :func:`release_losses` computes
what the release computes, to compare with it and to fine-tune its weights. They differ in this:

| term | paper, ours | release |
|---|---|---|
| simple | mean over frames per clip, then over clips | one mean over all frames of the batch |
| foot | feet that stand in the truth | feet that stand in the *prediction* |
| DM | pairs near in the *horizontal* plane in the *truth* | pairs near in space in the prediction |
| RO | difference of headings, as unit vectors | difference of half-angle quaternions |
| JA | none | pairs nearer than 0.1 m in the truth are pulled together |
| damping | I(t <= t_bar) per clip | mean over clips with t <= t_bar; RO of all if there is one |

The release calls ``torch.cross`` without a dimension, which takes the batch for the axes if there
are three clips in it. That is not reproduced.

Features are batches ``[B, T, 2 * 262]``, person a first; ``mask`` is 1 for frames that exist.
"""

from __future__ import annotations

import torch
from torch import Tensor

from generator.architecture import FEATURES
from generator.canonical import (
    CANONICAL_FEATURES,
    HEIGHT,
    LOCAL_CONTACTS,
    LOCAL_POSITIONS,
    PARTNER_DIRECTION,
    PARTNER_PLACE,
    STEP,
    TURN,
)
from generator.features import (
    CONTACT_HEIGHTS,
    CONTACT_POINTS,
    CONTACT_STEP,
    CONTACTS,
    POINTS,
    POSITIONS,
)
from generator.objective import ObjectiveConfig
from robots.skeleton import human_skeleton

RELEASE_T_BAR = 700
_PARENTS = list(human_skeleton().parents[1:])
_FEET = list(CONTACT_POINTS)
_TINY = 1e-7

Losses = dict[str, Tensor]


def interaction_losses(
    predicted: Tensor,
    target: Tensor,
    mask: Tensor,
    t: Tensor,
    mean: Tensor,
    std: Tensor,
    config: ObjectiveConfig | None = None,
) -> Losses:
    """Return the weighted terms of eq. (15) and their sum.

    Args:
        predicted: ``[B, T, 2F]`` normalised prediction of the clean motion.
        target: ``[B, T, 2F]`` normalised clean motion.
        mask: ``[B, T]``, or ``[B, T, 2]`` of which the first column counts.
        t: ``[B]`` diffusion steps.
        mean: ``[F]`` with which the features were normalised.
        std: ``[F]``.
        config: Weights and thresholds; those of the paper by default.

    Returns:
        ``simple``, ``velocity``, ``foot``, ``bone_length``, ``distance_map``,
        ``relative_orientation`` and ``total``; the terms add up to the total.
    """
    config = config or ObjectiveConfig()
    frames = _frame_mask(mask, predicted)
    error = _persons(predicted - target).square().mean(-1).mean(-1)
    losses = {"simple": _per_clip(error, frames).mean()}
    low = t <= config.last_regularised_step  # eq. (15); the others need not be computed
    terms = _regularisers(predicted[low], target[low], frames[low], mean, std, config)
    for name, value in terms.items():
        weight = config.regularisation * getattr(config, name)
        losses[name] = weight * value.sum() / len(t)
    losses["total"] = torch.stack(list(losses.values())).sum()
    return losses


def _regularisers(
    predicted: Tensor,
    target: Tensor,
    frames: Tensor,
    mean: Tensor,
    std: Tensor,
    config: ObjectiveConfig,
) -> Losses:
    """Return the terms of eq. (14) for each clip, unweighted, ``[B]``."""
    raw, true = (_persons(x) * std + mean for x in (predicted, target))
    points, truth = (_keypoints(x, config.representation) for x in (raw, true))
    contacts = LOCAL_CONTACTS if config.representation == "canonical" else CONTACTS
    steps, true_steps = (x[:, 1:] - x[:, :-1] for x in (points, truth))
    both = frames[:, 1:] * frames[:, :-1]
    standing = (true[:, :-1, :, contacts] > 0.5).to(raw.dtype)
    slides = steps[..., _FEET, :].square().mean(-1) * standing
    bones = (_bone_lengths(points) - _bone_lengths(truth)).square().mean(-1)
    heading = _heading(points) - _heading(truth)
    return {
        "velocity": _per_clip((steps - true_steps).square().mean((-1, -2)).sum(-1), both),
        "foot": _per_clip(slides.mean(-1).sum(-1), both),
        "bone_length": _per_clip(bones.sum(-1), frames),
        "distance_map": _distance_map(points, truth, frames, config.near),
        "relative_orientation": _per_clip(heading.square().sum(-1), frames),
    }


def _frame_mask(mask: Tensor, like: Tensor) -> Tensor:
    return (mask[..., 0] if mask.ndim == 3 else mask).to(like.dtype)


def _persons(x: Tensor) -> Tensor:
    """Return ``[B, T, 2, F]`` of ``[B, T, 2F]``."""
    return x.reshape(*x.shape[:2], 2, x.shape[2] // 2)


def _per_clip(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean ``[B]`` over the frames of ``values [B, T]`` that exist."""
    return (values * mask).sum(1) / mask.sum(1).clamp_min(1)


def _keypoints(features: Tensor, representation: str) -> Tensor:
    """Return ``[B, T, 2, 22, 3]`` m, y-up, of de-normalised features ``[B, T, 2, F]``."""
    if representation == "canonical":
        return keypoints_from_canonical(features)
    return features[..., POSITIONS].reshape(*features.shape[:3], POINTS, 3)


def keypoints_from_canonical(features: Tensor) -> Tensor:
    """Return ``[B, T, 2, 22, 3]`` m of canonical features ``[B, T, 2, 267]``.

    The same as :func:`generator.canonical.from_canonical`, for batches and with gradients.
    """
    if features.shape[-1] != CANONICAL_FEATURES:
        raise ValueError(f"{features.shape[-1]} features, not {CANONICAL_FEATURES}")
    first = features[:, :1, 0]
    direction = torch.atan2(*first[..., PARTNER_DIRECTION].flip(-1).unbind(-1))
    start = torch.stack([torch.zeros_like(direction), direction], dim=-1)
    turns = torch.cat([start, features[:, :-1, :, TURN]], dim=1)
    headings = turns.cumsum(1)
    place = first[..., PARTNER_PLACE]
    origin = torch.stack([torch.zeros_like(place), place], dim=2)
    steps = _turned(features[..., STEP], headings)
    roots = torch.cat([origin, steps[:, :-1]], dim=1).cumsum(1)
    local = features[..., LOCAL_POSITIONS].reshape(*features.shape[:3], POINTS - 1, 3)
    ground = _turned(local[..., ::2], headings[..., None]) + roots[..., None, :]
    others = torch.stack([ground[..., 0], local[..., 1], ground[..., 1]], dim=-1)
    pelvis = torch.stack([roots[..., 0], features[..., HEIGHT], roots[..., 1]], dim=-1)
    return torch.cat([pelvis[..., None, :], others], dim=-2)


def _turned(ground: Tensor, angle: Tensor) -> Tensor:
    """Return points ``[..., 2]`` (x, z) turned about y."""
    x, z = ground.unbind(-1)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos * x + sin * z, cos * z - sin * x], dim=-1)


def _bone_lengths(points: Tensor) -> Tensor:
    """Return ``[..., 21]`` m of keypoints ``[..., 22, 3]``."""
    return torch.linalg.vector_norm(points[..., 1:, :] - points[..., _PARENTS, :], dim=-1)


def _distances(points: Tensor) -> Tensor:
    """Return the map ``[B, T, 22, 22]`` m from every point of a to every point of b."""
    a, b = points.unbind(2)
    return torch.linalg.vector_norm(a[..., :, None, :] - b[..., None, :, :], dim=-1)


def _distance_map(points: Tensor, truth: Tensor, frames: Tensor, near: float) -> Tensor:
    """Eq. (12): squared errors of distances, mean over all near pairs of a clip; ``[B]``."""
    with torch.no_grad():
        close = (_squared_distances(truth[..., ::2]) < near**2) & (frames > 0)[..., None, None]
        counts = close.sum((1, 2, 3)).clamp_min(1)
        expected = _squared_distances(truth).clamp_min(_TINY**2).sqrt()
    error = _squared_distances(points).clamp_min(_TINY**2).sqrt() - expected
    return (error * close).square().sum((1, 2, 3)) / counts


def _squared_distances(points: Tensor) -> Tensor:
    """Return ``[B, T, 22, 22]`` m^2 by a matrix product: the loss spends most of its time here.

    Coordinates are taken from a's pelvis, so that little is lost where two large numbers cancel.
    """
    a, b = (points - points[:, :, :1, :1]).unbind(2)
    squares = a.square().sum(-1)[..., :, None] + b.square().sum(-1)[..., None, :]
    return squares - 2 * a @ b.transpose(-1, -2)


def _facing(points: Tensor) -> Tensor:
    """Return unit vectors ``[..., 2]`` (x, z) where the hips face; zero where they do not."""
    across = points[..., 2, :] - points[..., 1, :]
    forward = torch.stack([across[..., 2], -across[..., 0]], dim=-1)
    length = torch.linalg.vector_norm(forward, dim=-1, keepdim=True)
    return forward / length.clamp_min(_TINY)


def _heading(points: Tensor) -> Tensor:
    """Return cosine and sine ``[B, T, 2]`` of b's heading relative to a's."""
    (ax, az), (bx, bz) = (f.unbind(-1) for f in _facing(points).unbind(2))
    return torch.stack([ax * bx + az * bz, az * bx - ax * bz], dim=-1)


def release_losses(
    x0_raw: Tensor,
    x0_norm: Tensor,
    pred_norm: Tensor,
    mask: Tensor,
    lengths: Tensor,
    t: Tensor,
    mean: Tensor,
    std: Tensor,
) -> Losses:
    """Return every loss of the public release, weighted, under the release's names.

    Args:
        x0_raw: ``[B, T, 524]`` clean motion, metres.
        x0_norm: ``[B, T, 524]`` the same, normalised.
        pred_norm: ``[B, T, 524]`` prediction, normalised.
        mask: ``[B, T]``, or ``[B, T, 2]`` of which the first column counts for both people.
        lengths: ``[B]`` frames of each clip; must agree with ``mask``.
        t: ``[B]`` diffusion steps.
        mean: ``[262]``.
        std: ``[262]``.

    Raises:
        ValueError: A shape does not fit, or mask and lengths disagree.
    """
    frames = _frame_mask(mask, pred_norm)
    if x0_raw.shape != pred_norm.shape or pred_norm.shape[-1] != 2 * FEATURES:
        raise ValueError(f"features {tuple(x0_raw.shape)}, {tuple(pred_norm.shape)}")
    if not torch.equal(frames.sum(1).long(), lengths.long()):
        raise ValueError(f"the mask has {frames.sum(1).tolist()} frames, not {lengths.tolist()}")
    points = _keypoints(_persons(pred_norm) * std + mean, "non_canonical")
    truth = _keypoints(_persons(x0_raw), "non_canonical")
    low = (t <= RELEASE_T_BAR).to(points.dtype)

    def damped(values: Tensor, valid: Tensor) -> Tensor:
        return (_per_clip(values, valid) * low).sum() / (low.sum() + _TINY)

    losses: Losses = {}
    for i, name in enumerate("AB"):
        terms = _release_person(points[:, :, i], truth[:, :, i])
        losses[f"VEL_{name}"] = 30 * damped(terms[0], frames[:, :-1])
        losses[f"BL_{name}"] = 10 * damped(terms[1], frames)
        losses[f"FC_{name}"] = 30 * damped(terms[2], frames[:, :-1])
        losses[name] = losses[f"VEL_{name}"] + losses[f"BL_{name}"] + losses[f"FC_{name}"]
    error = _persons(pred_norm - x0_norm).square().mean((-1, -2))
    losses["simple"] = (error * frames).sum() / frames.sum()
    distance, true_distance = _distances(points), _distances(truth)
    errors = (distance - true_distance).square()
    losses["DM"] = 3 * damped(_selected(errors, distance.detach() < 1.0), frames)
    losses["JA"] = 3 * damped(_selected(distance.square(), true_distance < 0.1), frames)
    turn = (_half_turn(points) - _half_turn(truth)).square().mean(-1)
    any_low = (low.sum() > 0).to(points.dtype)
    losses["RO"] = 0.01 * any_low * (turn * frames).sum() / frames.sum()
    parts = ("A", "B", "simple", "DM", "JA", "RO")
    losses["total"] = torch.stack([losses[name] for name in parts]).sum()
    return losses


def _release_person(points: Tensor, truth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return velocity ``[B, T-1]``, bone length ``[B, T]`` and foot errors ``[B, T-1]``."""
    steps, true_steps = (x[:, 1:] - x[:, :-1] for x in (points, truth))
    velocity = (steps - true_steps).square().mean((-1, -2))
    bones = (_bone_lengths(points) - _bone_lengths(truth)).square().mean(-1)
    slides = steps[..., _FEET, :].square()
    heights = points.new_tensor(CONTACT_HEIGHTS)
    low = points[:, :-1, _FEET, 1] < heights
    return velocity, bones, _selected(slides.mean(-1), (slides.sum(-1) < CONTACT_STEP) & low)


def _selected(values: Tensor, chosen: Tensor) -> Tensor:
    """Return the mean ``[B, T]`` of the chosen ``values [B, T, ...]`` of each frame, 0 if none."""
    weights = chosen.to(values.dtype).flatten(2)
    return (values.flatten(2) * weights).sum(-1) / (weights.sum(-1) + _TINY)


def _half_turn(points: Tensor) -> Tensor:
    """Return cosine and sine ``[B, T, 2]`` of half the turn from a's facing to b's.

    They are w and y of the quaternion ``(|f||g| + f.g, f x g)``, normalised.
    """
    a, b = _facing(points).unbind(2)
    w = torch.linalg.vector_norm(a, dim=-1) * torch.linalg.vector_norm(b, dim=-1) + (a * b).sum(-1)
    y = a[..., 1] * b[..., 0] - a[..., 0] * b[..., 1]
    quaternion = torch.stack([w, y], dim=-1)
    length = torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True)
    return quaternion / length.clamp_min(_TINY)
