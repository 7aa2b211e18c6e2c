"""Losses: the release's to the last digit, the paper's by what they mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from generator.canonical import from_canonical, to_canonical  # noqa: E402
from generator.features import POSITIONS, VELOCITIES, encode  # noqa: E402
from generator.losses import (  # noqa: E402
    interaction_losses,
    keypoints_from_canonical,
    release_losses,
)
from generator.objective import ObjectiveConfig  # noqa: E402
from generator.placement import turn_about_y  # noqa: E402
from robots.errors import SpecError  # noqa: E402

torch.set_num_threads(1)

TERMS = ("velocity", "foot", "bone_length", "distance_map", "relative_orientation")


@pytest.fixture(scope="module")
def arrays(golden):
    with np.load(golden / "losses.npz", allow_pickle=False) as file:
        return {name: torch.from_numpy(np.asarray(file[name])) for name in file.files}


@pytest.fixture(scope="module")
def statistics(arrays):
    """Mean and std, which are not stored but relate the raw to the normalised features."""
    raw = arrays["x_start_raw"].double().reshape(-1, 262)
    norm = arrays["x_start_norm"].double().reshape(-1, 262)
    std = raw.std(0) / norm.std(0).clamp_min(1e-9)
    return (raw - norm * std).mean(0).float(), std.float()


def release(arrays, statistics, *, t="t", clips=slice(None), **changes):
    names = ("x_start_raw", "x_start_norm", "pred_norm", "mask", "lens", t)
    values = [changes.get(name, arrays[name])[clips] for name in names]
    return release_losses(*values, *statistics)


@pytest.mark.parametrize(
    ("t", "prefix"),
    [("t", "loss_"), ("t_all_low", "loss_all_low_"), ("t_none_low", "loss_none_low_")],
)
def test_parity_of_every_term(arrays, statistics, t, prefix):
    losses = release(arrays, statistics, t=t)
    names = {name for name in arrays if name.startswith(prefix)}
    if prefix == "loss_":
        names = {name for name in names if not name.startswith(("loss_all", "loss_none"))}
    assert {prefix + name for name in losses} == names
    for name, value in losses.items():
        expected = float(arrays[prefix + name])
        assert float(value) == pytest.approx(expected, rel=1e-4, abs=1e-10), name


def test_parity_of_the_gradient(arrays, statistics):
    prediction = arrays["pred_norm"].clone().requires_grad_()
    release(arrays, statistics, pred_norm=prediction)["total"].backward()
    expected = arrays["grad_total_wrt_pred"]
    assert prediction.grad is not None
    assert (prediction.grad - expected).abs().max() < 1e-4 * expected.abs().max()


def test_parity_of_single_clips(arrays, statistics):
    for i, expected in enumerate(arrays["batch1_each_loss_RO"].tolist()):
        losses = release(arrays, statistics, clips=slice(i, i + 1))
        assert float(losses["RO"]) == pytest.approx(expected, rel=1e-4, abs=1e-10)


def test_parity_of_three_clips_but_for_the_release_s_cross_product(arrays, statistics):
    """With a batch of 3 the release crosses over the batch axis; ours is the mean it should be."""
    losses = release(arrays, statistics, clips=slice(0, 3))
    rest = float(arrays["quirk_batch3_loss_total"] - arrays["quirk_batch3_loss_RO"])
    assert float(losses["total"] - losses["RO"]) == pytest.approx(rest, rel=1e-4)
    assert float(losses["RO"]) > 5 * float(arrays["quirk_batch3_loss_RO"])


def test_masks_that_disagree_with_lengths_are_refused(arrays, statistics):
    with pytest.raises(ValueError, match="frames"):
        release(arrays, statistics, lens=arrays["lens"] - 1)


def test_the_release_pulls_together_only_what_nearly_touches(batch):
    """No pair of the reference vectors lies just above the threshold of 0.1 m, so ours does."""
    x, mask, _, _ = batch
    mean, std = torch.zeros(262).double(), torch.ones(262).double()
    for gap, pulled in ((0.09, True), (0.11, False)):
        y = x.clone().view(2, 19, 2, 262)
        y[:, :, :, POSITIONS] = 0
        y[:, :, 1, : 3 * 22 : 3] = 5 + torch.arange(22).double()
        y[:, :, 1, 0] = gap
        flat = y.view(2, 19, 524)
        lengths = mask.sum(1).long()
        losses = release_losses(flat, flat, flat, mask, lengths, torch.tensor([1, 2]), mean, std)
        expected = 3 * gap**2 if pulled else 0
        assert losses["JA"].item() == pytest.approx(expected, rel=1e-5)


# --- the paper's form ------------------------------------------------------------------------


@pytest.fixture
def batch(make_duet):
    """Two clips of different length, padded with zeros; the statistics are neither 0 nor 1."""
    rng = np.random.default_rng(0)
    clips = [encode(make_duet(frames=n, seed=n)).reshape(n - 1, 524) for n in (20, 13)]
    x = torch.zeros(2, 19, 524, dtype=torch.float64)
    mask = torch.zeros(2, 19, dtype=torch.float64)
    for i, clip in enumerate(clips):
        x[i, : len(clip)] = torch.from_numpy(clip)
        mask[i, : len(clip)] = 1
    mean = torch.from_numpy(rng.normal(size=262) * 0.1)
    std = torch.from_numpy(rng.uniform(0.1, 1, size=262))
    return x, mask, mean, std


def paper(batch, predicted, *, t=(0, 0), target=None, **changes):
    x, mask, mean, std = batch
    target = x if target is None else target
    config = ObjectiveConfig(**changes)

    def norm(values):
        return (values.reshape(2, 19, 2, 262) - mean).div(std).reshape(2, 19, 524)

    return interaction_losses(
        norm(predicted), norm(target), mask, torch.tensor(t), mean, std, config
    )


def person(x, i):
    return x.view(2, 19, 2, 262)[:, :, i]


def turned(x, i, angle, shift=(0.0, 0.0, 0.0)):
    """Turn person ``i`` rigidly about the vertical axis through its first pelvis."""
    out = x.clone()
    block = person(out, i)
    points = block[..., POSITIONS].reshape(2, 19, 22, 3).numpy()
    pivot = points[:, :1, :1] * (1, 0, 1)
    moved = turn_about_y(points - pivot, angle) + pivot + np.array(shift)
    block[..., POSITIONS] = torch.from_numpy(moved).reshape(2, 19, 66)
    return out


def test_a_perfect_prediction_costs_nothing_but_the_feet_of_the_truth(batch):
    losses = paper(batch, batch[0])
    for name in ("simple", *TERMS):
        if name != "foot":
            assert float(losses[name]) == pytest.approx(0, abs=1e-12), name


def test_the_terms_add_up_and_scale_with_their_weights(batch):
    predicted = batch[0] + 0.05 * torch.randn(batch[0].shape, generator=torch.manual_seed(0))
    losses = paper(batch, predicted)
    assert float(losses["total"]) == pytest.approx(
        sum(float(v) for n, v in losses.items() if n != "total")
    )
    for name in TERMS:
        assert float(losses[name]) > 0
        weight = getattr(ObjectiveConfig(), name)
        doubled = paper(batch, predicted, **{name: 2 * weight})
        assert float(doubled[name]) == pytest.approx(2 * float(losses[name]))
        assert float(paper(batch, predicted, regularisation=0.5)[name]) == pytest.approx(
            0.5 * float(losses[name])
        )
    assert float(paper(batch, predicted, regularisation=0)["total"]) == pytest.approx(
        float(losses["simple"])
    )


def test_damping_drops_the_clips_above_the_threshold(batch):
    predicted = batch[0] + 0.05 * torch.randn(batch[0].shape, generator=torch.manual_seed(1))
    low, mixed, high = (paper(batch, predicted, t=t) for t in ((700, 0), (700, 701), (701, 999)))
    late = paper(batch, predicted, t=(701, 700))
    for name in TERMS:
        assert float(high[name]) == 0
        assert float(mixed[name]) + float(late[name]) == pytest.approx(float(low[name]))
    assert float(high["simple"]) == pytest.approx(float(low["simple"]))
    everywhere = paper(batch, predicted, t=(701, 999), damping=1.0)
    assert float(everywhere["velocity"]) == pytest.approx(float(low["velocity"]))
    nowhere = paper(batch, predicted, t=(101, 999), damping=0.1)
    assert float(nowhere["velocity"]) == 0


def test_padding_does_not_count(batch):
    predicted = batch[0].clone()
    predicted[1, 12:] = 7.0
    losses = paper(batch, predicted)
    clean = paper(batch, batch[0])
    for name, value in losses.items():
        assert float(value) == pytest.approx(float(clean[name]), abs=1e-12), name


def test_moving_both_people_together_costs_no_interaction(batch):
    shifted = batch[0].clone().view(2, 19, 2, 262)
    shifted[..., POSITIONS] += torch.tensor([0.3, 0.0, -0.2], dtype=torch.float64).repeat(22)
    losses = paper(batch, shifted.view(2, 19, 524))
    for name in ("velocity", "bone_length", "distance_map", "relative_orientation"):
        assert float(losses[name]) == pytest.approx(0, abs=1e-12), name
    assert float(losses["simple"]) > 0


def test_the_relative_orientation_is_the_turn_between_the_people(batch):
    for angle in (0.3, 1.0, 2.5):
        losses = paper(batch, turned(batch[0], 1, angle), relative_orientation=1.0)
        expected = 2 - 2 * np.cos(angle)  # squared distance of two unit vectors
        assert float(losses["relative_orientation"]) == pytest.approx(expected, rel=1e-6)
        same = paper(batch, turned(turned(batch[0], 1, angle), 0, angle))
        assert float(same["relative_orientation"]) == pytest.approx(0, abs=1e-12)


def test_the_distance_map_sees_only_who_is_near_in_the_truth(batch):
    wrong = turned(batch[0], 1, 0.0, shift=(0.0, 0.0, 0.1))
    near = float(paper(batch, wrong, near=50.0, distance_map=1.0)["distance_map"])
    assert 0 < near <= 0.1**2 + 1e-9
    assert float(paper(batch, wrong, near=0.01)["distance_map"]) == 0
    # Height does not make people far: lift b in truth and prediction by 3 m.
    up = (0.0, 3.0, 0.0)
    losses = paper(
        batch,
        turned(wrong, 1, 0.0, shift=up),
        target=turned(batch[0], 1, 0.0, shift=up),
        near=1.5,
    )
    assert float(losses["distance_map"]) > 0


def test_the_distance_map_is_a_mean_over_the_near_pairs_of_a_clip(batch):
    """Written out with numpy, from positions, pair by pair."""
    x, mask = batch[0], batch[1].numpy().astype(bool)
    noise = torch.randn(x.shape, generator=torch.manual_seed(3)).double()
    predicted = x + 0.1 * noise
    values = []
    for clip in range(2):
        points, truth = (
            y.view(2, 19, 2, 262)[clip, mask[clip]][..., POSITIONS].reshape(-1, 2, 22, 1, 3).numpy()
            for y in (predicted, x)
        )
        gaps = [p[:, 0] - p[:, 1].swapaxes(1, 2) for p in (points, truth)]
        far, expected = (np.linalg.norm(gap, axis=-1) for gap in gaps)
        near = np.linalg.norm(gaps[1][..., ::2], axis=-1) < 0.8
        assert 0.02 < near.mean() < 0.98
        values.append(((far - expected)[near] ** 2).mean())
    losses = paper(batch, predicted, near=0.8, distance_map=1.0)
    assert losses["distance_map"].item() == pytest.approx(np.mean(values), rel=1e-9)


def test_bone_length_and_velocity_mean_what_they_say(batch):
    x = batch[0].clone().view(2, 19, 2, 262)
    grown = x.clone()
    grown[..., POSITIONS] *= 1.1
    points = x[..., POSITIONS].reshape(2, 19, 2, 22, 3)
    from robots.skeleton import human_skeleton

    parents = list(human_skeleton().parents[1:])
    lengths = (points[..., 1:, :] - points[..., parents, :]).norm(dim=-1)
    expected = (0.1 * lengths[0, :19]).square().mean(-1).sum(-1).mean()
    expected += (0.1 * lengths[1, :12]).square().mean(-1).sum(-1).mean()
    losses = paper(batch, grown.view(2, 19, 524), bone_length=1.0)
    assert float(losses["bone_length"]) == pytest.approx(float(expected) / 2, rel=1e-9)
    drifting = x.clone()
    drifting[..., POSITIONS] += 0.02 * torch.arange(19).double().view(1, 19, 1, 1)
    losses = paper(batch, drifting.view(2, 19, 524), velocity=1.0)
    assert float(losses["velocity"]) == pytest.approx(2 * 0.02**2, rel=1e-9)


def test_feet_that_stand_in_the_truth_must_not_slide(batch):
    x = batch[0].clone().view(2, 19, 2, 262)
    x[..., 258:] = torch.tensor([1.0, 1, 0, 0], dtype=torch.float64)
    x[..., POSITIONS] = x[:, :1, :, POSITIONS]
    x[..., VELOCITIES] = 0
    sliding = x.clone()
    sliding[..., 3 * 7] += 0.01 * torch.arange(19).double().view(1, 19, 1)
    losses = paper(batch, sliding.view(2, 19, 524), target=x.view(2, 19, 524), foot=1.0)
    # One of three coordinates of one of four feet, both people: 2 * 0.01^2 / 3 / 4.
    assert float(losses["foot"]) == pytest.approx(2 * 0.01**2 / 12, rel=1e-9)
    lifted = x.clone()
    lifted[..., 258:] = 0
    free = paper(batch, sliding.view(2, 19, 524), target=lifted.view(2, 19, 524), foot=1.0)
    assert float(free["foot"]) == 0


def test_gradients_are_finite_even_for_zeros(batch):
    predicted = torch.zeros_like(batch[0]).requires_grad_()
    mean, std = torch.zeros(262, dtype=torch.float64), torch.ones(262, dtype=torch.float64)
    losses = interaction_losses(predicted, batch[0], batch[1], torch.tensor([0, 5]), mean, std)
    losses["total"].backward()
    assert predicted.grad is not None
    assert predicted.grad.isfinite().all()
    lengths = batch[1].sum(1).long()
    again = torch.zeros_like(batch[0]).requires_grad_()
    losses = release_losses(
        batch[0], batch[0], again, batch[1], lengths, torch.tensor([0, 5]), mean, std
    )
    losses["total"].backward()
    assert again.grad is not None
    assert again.grad.isfinite().all()


def test_canonical_features_give_the_same_keypoints_and_losses(make_duet):
    canonical = to_canonical(encode(make_duet(frames=20)))
    expected = from_canonical(canonical)[..., POSITIONS].reshape(1, 19, 2, 22, 3)
    x = torch.from_numpy(canonical)[None]
    points = keypoints_from_canonical(x)
    np.testing.assert_allclose(points.numpy(), expected, atol=1e-9)
    with pytest.raises(ValueError, match="267"):
        keypoints_from_canonical(x[..., :262])
    flat = x.reshape(1, 19, 534)
    mean, std = torch.zeros(267).double(), torch.ones(267).double()
    config = ObjectiveConfig(representation="canonical")
    noisy = flat + 0.01 * torch.randn(flat.shape, generator=torch.manual_seed(2)).double()
    losses = interaction_losses(
        noisy.requires_grad_(), flat, torch.ones(1, 19), torch.tensor([3]), mean, std, config
    )
    losses["total"].backward()
    assert noisy.grad is not None
    assert noisy.grad.isfinite().all()
    assert all(losses[name].item() > 0 for name in TERMS)


@pytest.mark.parametrize(
    "change",
    [
        {"velocity": -1.0},
        {"near": float("nan")},
        {"damping": 1.5},
        {"steps": 0},
        {"representation": "polar"},
    ],
)
def test_an_absurd_objective_is_refused(change):
    with pytest.raises(SpecError, match=next(iter(change))):
        ObjectiveConfig(**change)
    assert replace(ObjectiveConfig(), damping=0.3).last_regularised_step == pytest.approx(300)
