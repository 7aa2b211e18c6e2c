"""Noise schedules and samplers: against reference vectors, and against exact solutions."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.checkpoint import load_release
from generator.diffusion import (
    STEPS,
    SamplerConfig,
    cosine_alphas,
    cosine_betas,
    sample,
    timesteps,
)
from generator.guidance import Guided
from generator.model import InterGen, fresh_noise
from generator.schedule import warmup_cosine
from generator.smoothing import smooth
from generator.training.draws import noised
from robots.errors import SpecError

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def tables(golden: Path) -> dict[str, np.ndarray]:
    with np.load(golden / "diffusion_tables.npz") as archive:
        return dict(archive)


@pytest.fixture(scope="module")
def ddim(golden: Path) -> dict[str, np.ndarray]:
    with np.load(golden / "ddim_small.npz") as archive:
        return dict(archive)


@pytest.fixture(scope="module")
def released(golden: Path) -> InterGen:
    return load_release(golden / "small_intergen_decoder.ckpt")


def test_schedule_tables_are_at_parity(tables):
    np.testing.assert_allclose(cosine_betas(), tables["betas_1000"], rtol=1e-13)
    np.testing.assert_allclose(cosine_alphas(), tables["alphas_cumprod_1000"], rtol=1e-13)


def test_respaced_tables_are_at_parity(tables):
    steps = timesteps(50, "leading")[::-1]
    alphas = cosine_alphas()[steps]
    previous = np.append(1.0, alphas[:-1])
    np.testing.assert_array_equal(steps, tables["timestep_map_50"])
    np.testing.assert_allclose(alphas, tables["alphas_cumprod_50"], rtol=1e-12)
    np.testing.assert_allclose(previous, tables["alphas_cumprod_prev_50"], rtol=1e-12)
    np.testing.assert_allclose(1 - alphas / previous, tables["betas_50"], rtol=1e-10)
    recip = np.sqrt(1 / alphas), np.sqrt(1 / alphas - 1)
    np.testing.assert_allclose(recip[0], tables["sqrt_recip_alphas_cumprod_50"], rtol=1e-12)
    np.testing.assert_allclose(recip[1], tables["sqrt_recipm1_alphas_cumprod_50"], rtol=1e-10)


@pytest.mark.parametrize("steps", [10, 20, 25, 100])
def test_step_maps_are_at_parity(tables, steps):
    expected = tables[f"timestep_map_ddim{steps}"]
    np.testing.assert_array_equal(timesteps(steps, "leading")[::-1], expected)


def test_learning_rates_are_at_parity(tables):
    rates = [1e-4 * warmup_cosine(e, 10, 2000, release_compat=True) for e in range(2001)]
    np.testing.assert_allclose(rates, tables["lr_by_epoch"], rtol=1e-12, atol=1e-20)


def test_learning_rate_never_exceeds_its_maximum_without_compatibility():
    rates = [warmup_cosine(e, 10, 2000) for e in range(2001)]
    assert max(rates) <= 1
    assert rates[0] == pytest.approx(0.1)
    assert rates[2000] == pytest.approx(0, abs=1e-12)
    assert all(later <= earlier for earlier, later in pairwise(rates[10:]))


def test_every_stored_ddim_step_is_at_parity(released, ddim):
    cond, noise = torch.from_numpy(ddim["cond"]), torch.from_numpy(ddim["x_T"])
    config = SamplerConfig(guidance=float(ddim["guidance"]))
    guided = Guided(released.denoiser, cond, config)
    seen: list[np.ndarray] = []
    clean: list[np.ndarray] = []

    def predict(x: torch.Tensor, step: int) -> torch.Tensor:
        seen.append(x.numpy())
        with torch.no_grad():
            out = guided(x, step)
        clean.append(out.numpy())
        return out

    final = sample(predict, noise, config).numpy()
    seen.append(final)
    assert len(clean) == 50
    for i, step in enumerate(ddim["step_index"]):
        tolerance = {"rtol": 0, "atol": 1e-3, "err_msg": f"step {step}"}
        np.testing.assert_allclose(clean[step], ddim["pred_xstart_steps"][i], **tolerance)
        np.testing.assert_allclose(seen[step + 1], ddim["sample_steps"][i], **tolerance)
    np.testing.assert_allclose(final, ddim["final"], rtol=0, atol=1e-3)


def test_sampling_from_a_seed_is_at_parity(released, ddim):
    cond = torch.from_numpy(ddim["cond"])
    drawn = released.sample(cond, 48, seed=int(ddim["torch_seed"]))
    np.testing.assert_allclose(drawn, ddim["final_from_torch_seed"], rtol=0, atol=1e-3)


def test_denormalised_sample_is_at_parity(released, ddim):
    """Statistics are not in the checkpoint; they follow from the stored pair of arrays."""
    final = ddim["final"].reshape(-1, 262).astype(np.float64)
    raw = ddim["denormalised"].reshape(-1, 262).astype(np.float64)
    std = ((final - final.mean(0)) * (raw - raw.mean(0))).sum(0) / final.var(0) / len(final)
    mean = raw.mean(0) - std * final.mean(0)
    model = InterGen(released.config, mean=mean, std=std)
    out = model.denormalise(torch.from_numpy(ddim["final"])).reshape(2, 48, 2, 262)
    np.testing.assert_allclose(out, ddim["denormalised"], rtol=1e-4, atol=1e-4)
    back = model.normalise(out.flatten(2))
    np.testing.assert_allclose(back, ddim["final"], rtol=1e-3, atol=1e-2)


def test_smoothing_is_at_parity(golden):
    with np.load(golden / "postprocess.npz") as archive:
        np.testing.assert_allclose(
            smooth(archive["joints_in"], 1.0), archive["joints_out"], rtol=0, atol=1e-6
        )


def test_smoothing_keeps_a_standing_body_and_can_be_off():
    still = np.ones((7, 2, 3)) * [1.0, 2.0, 3.0]
    np.testing.assert_allclose(smooth(still, 2.0), still, atol=1e-12)
    rough = np.random.default_rng(0).normal(size=(9, 3))
    np.testing.assert_array_equal(smooth(rough, 0), rough)


# Exact solutions: data that are a mixture of Gaussians have a closed best denoiser.


def mixture(x: torch.Tensor, step: int, centres: tuple[float, ...], spread: float) -> torch.Tensor:
    """Return the mean of clean x0 given x_t, for x0 from equal Gaussians around ``centres``."""
    alpha = float(cosine_alphas()[step])
    variance = alpha * spread**2 + 1 - alpha
    means = torch.tensor(centres, dtype=x.dtype)
    logits = -((x[..., None] - math.sqrt(alpha) * means) ** 2) / (2 * variance)
    share = logits.softmax(dim=-1)
    gain = math.sqrt(alpha) * spread**2 / variance
    each = means + gain * (x[..., None] - math.sqrt(alpha) * means)
    return (share * each).sum(dim=-1)


def gaussian_error(solver: str, steps: int, spread: float = 0.5) -> float:
    """Return the largest error of the state at step 200 against the exact flow.

    For one Gaussian the flow multiplies x by the ratio of the marginal deviations.
    """
    states = {}

    def predict(x: torch.Tensor, step: int) -> torch.Tensor:
        states[step] = x
        return mixture(x, step, (0.0,), spread)

    noise = torch.linspace(-3, 3, 31, dtype=torch.float64)[None, :, None]
    config = SamplerConfig(solver=solver, steps=steps, guidance=1)  # type: ignore[arg-type]
    sample(predict, noise, config)
    first = timesteps(steps, "leading")[0]
    deviation = np.sqrt(cosine_alphas() * spread**2 + 1 - cosine_alphas())
    exact = noise * deviation[200] / deviation[first]
    return float((states[200] - exact).abs().max())


def test_ddim_converges_with_first_order_and_dpm_solver_with_second():
    counts = [50, 100, 200, 500]
    slopes = {}
    for solver in ("ddim", "dpm2m"):
        errors = [gaussian_error(solver, steps) for steps in counts]
        slopes[solver] = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert 0.8 < slopes["ddim"] < 1.4
    assert slopes["dpm2m"] > 1.7


@pytest.mark.parametrize("steps", [10, 20, 50])
def test_dpm_solver_beats_ddim_at_equal_steps(steps):
    def predict(x: torch.Tensor, step: int) -> torch.Tensor:
        return mixture(x, step, (-1.0, 0.5, 2.0), 0.2)

    noise = torch.randn(1, 400, 1, dtype=torch.float64, generator=torch.manual_seed(0))
    fine = sample(predict, noise, SamplerConfig(steps=1000, spacing="trailing", guidance=1))
    error = {
        solver: float(
            (
                sample(
                    predict,
                    noise,
                    SamplerConfig(solver=solver, steps=steps, spacing="trailing", guidance=1),
                )
                - fine
            )
            .abs()
            .mean()
        )
        for solver in ("ddim", "dpm2m")
    }
    assert error["dpm2m"] < 0.7 * error["ddim"]


@pytest.mark.parametrize("eta", [0.0, 0.5, 1.0])
def test_fresh_noise_keeps_the_variance(eta):
    def predict(x: torch.Tensor, step: int) -> torch.Tensor:
        return mixture(x, step, (0.0,), 0.8)

    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(1, 20_000, 1, generator=generator)
    config = SamplerConfig(steps=500, spacing="trailing", eta=eta, guidance=1)
    states = {}

    def remember(x: torch.Tensor, step: int) -> torch.Tensor:
        states[step] = x
        return predict(x, step)

    sample(remember, noise, config, fresh=fresh_noise(generator))
    for step in (499, 99, 9):  # of 999, 997, ... 1
        alpha = cosine_alphas()[step]
        assert float(states[step].var()) == pytest.approx(alpha * 0.64 + 1 - alpha, rel=0.04)


def test_fresh_noise_comes_from_the_given_generator():
    def draw(seed: int) -> torch.Tensor:
        config = SamplerConfig(steps=5, eta=1.0, guidance=1)
        generator = torch.Generator().manual_seed(seed)
        fresh = fresh_noise(generator)
        return sample(lambda x, step: 0.3 * x, torch.ones(1, 4, 1), config, fresh=fresh)

    assert torch.equal(draw(1), draw(1))
    assert not torch.equal(draw(1), draw(2))


@given(steps=st.integers(1, STEPS), spacing=st.sampled_from(["leading", "trailing"]))
def test_steps_fall_and_stay_in_range(steps, spacing):
    visited = timesteps(steps, spacing)
    assert len(visited) == steps
    assert all(later < earlier for earlier, later in pairwise(visited))
    assert visited[0] < STEPS
    assert visited[-1] >= 0


def test_trailing_spacing_starts_at_pure_noise_and_leading_ends_clean():
    for steps in (1, 4, 10, 50):
        assert timesteps(steps, "trailing")[0] == STEPS - 1
        assert timesteps(steps, "leading")[-1] == 0


@settings(deadline=None)
@given(
    solver=st.sampled_from(["ddim", "dpm2m"]),
    spacing=st.sampled_from(["leading", "trailing"]),
    steps=st.integers(1, 30),
)
def test_a_perfect_denoiser_is_believed(solver, spacing, steps):
    truth = torch.linspace(-2, 2, 6).reshape(1, 3, 2)
    config = SamplerConfig(solver, steps, spacing)
    states = {}

    def predict(x: torch.Tensor, step: int) -> torch.Tensor:
        states[step] = x
        return truth

    noise = torch.randn(1, 3, 2, generator=torch.manual_seed(0))
    assert torch.equal(sample(predict, noise, config), truth)
    first, last = timesteps(steps, spacing)[0], timesteps(steps, spacing)[-1]
    before, after = cosine_alphas()[first], cosine_alphas()[last]
    eps = (noise - math.sqrt(before) * truth) / math.sqrt(1 - before)
    expected = math.sqrt(after) * truth + math.sqrt(1 - after) * eps
    torch.testing.assert_close(states[last], expected, rtol=1e-3, atol=1e-3)


def test_a_constraint_holds_exactly_in_the_result_and_progress_ends_at_one():
    shares = []

    def constrain(clean: torch.Tensor, step: int) -> torch.Tensor:
        return torch.cat([torch.full_like(clean[:, :1], 0.25), clean[:, 1:]], dim=1)

    out = sample(
        lambda x, step: x,
        torch.randn(1, 4, 2),
        SamplerConfig(steps=4),
        constrain=constrain,
        progress=shares.append,
    )
    assert (out[:, 0] == 0.25).all()
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_noised_motion_has_the_variance_of_its_step():
    clean, noise = torch.full((3, 2, 1), 2.0), torch.full((3, 2, 1), -1.0)
    t = torch.tensor([0, 500, 999])
    alphas = torch.from_numpy(cosine_alphas()[t]).float().reshape(3, 1, 1)
    expected = (2 * alphas.sqrt() - (1 - alphas).sqrt()).expand(3, 2, 1)
    torch.testing.assert_close(noised(clean, t, noise), expected)


@pytest.mark.parametrize(
    "settings",
    [
        {"steps": 0},
        {"steps": 1001},
        {"eta": 1.5},
        {"solver": "dpm2m", "eta": 0.5},
        {"solver": "euler"},
        {"spacing": "trailling"},
    ],
)
def test_an_impossible_sampler_is_refused(settings):
    with pytest.raises(SpecError):
        SamplerConfig(**settings)
