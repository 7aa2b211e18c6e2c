"""The whole model: normalisation, sampling, and a sentence made into a duet."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from generator.architecture import DenoiserConfig
from generator.canonical import to_canonical
from generator.diffusion import SamplerConfig, timesteps
from generator.features import encode
from generator.guidance import Guided
from generator.model import InterGen
from generator.provenance import Provenance
from robots.errors import CheckpointError, PromptError, SpecError

torch.set_num_threads(1)

TINY = DenoiserConfig(width=16, layers=2, heads=2, feedforward=32, features=6, text_width=5)


class LengthEncoder:
    """Sentences to vectors of their length."""

    def encode(self, sentences):
        return np.array([[len(s) / 10 + i for i in range(5)] for s in sentences], np.float32)


def randomised(config: DenoiserConfig = TINY, **options: object) -> InterGen:
    torch.manual_seed(0)
    model = InterGen(config, **options)  # type: ignore[arg-type]
    for value in model.parameters():
        torch.nn.init.normal_(value, std=0.3)
    return model.eval()


def test_exchanging_the_persons_noise_exchanges_the_sample_exactly():
    model, cond, noise = randomised(), torch.randn(2, 5), torch.randn(2, 9, 12)
    for solver in ("ddim", "dpm2m"):
        out = model.sample(cond, 9, steps=6, solver=solver, x_T=noise)
        exchanged = model.sample(cond, 9, steps=6, solver=solver, x_T=noise.roll(6, dims=-1))
        assert torch.equal(exchanged, out.roll(6, dims=-1))


def test_the_same_seed_gives_the_same_sample_and_leaves_torchs_own_alone():
    model, cond = randomised(), torch.randn(1, 5)
    torch.manual_seed(5)
    state = torch.get_rng_state()
    first = model.sample(cond, 7, seed=1, steps=3, eta=1.0)
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(model.sample(cond, 7, seed=1, steps=3, eta=1.0), first)
    assert not torch.equal(model.sample(cond, 7, seed=2, steps=3, eta=1.0), first)


def test_a_sample_does_not_depend_on_its_batch():
    model, cond, noise = randomised(), torch.randn(3, 5), torch.randn(3, 8, 12)
    together = model.sample(cond, 8, steps=4, x_T=noise)
    alone = model.sample(cond[1:2], 8, steps=4, x_T=noise[1:2])
    torch.testing.assert_close(together[1:2], alone, rtol=1e-4, atol=1e-4)


def test_sampling_switches_dropout_off_and_training_mode_back_on():
    model, cond = randomised(), torch.randn(1, 5)
    expected = model.sample(cond, 8, seed=0, steps=3)
    model.train()
    assert torch.equal(model.sample(cond, 8, seed=0, steps=3), expected)
    assert model.training


@torch.no_grad()
def test_modulations_made_ahead_are_those_of_the_network_itself(monkeypatch):
    model, cond, x = randomised(), torch.randn(2, 5), torch.randn(2, 9, 12)
    config = SamplerConfig(steps=10)
    guided = Guided(model.denoiser, cond, config)
    monkeypatch.setattr("generator.guidance.CACHE_BYTES", 0)
    lazy = Guided(model.denoiser, cond, config)
    for step in (0, 300, 900):
        t = torch.full((2,), step)
        without = model.denoise(x, t, torch.zeros_like(cond))
        expected = without + 3.5 * (model.denoise(x, t, cond) - without)
        torch.testing.assert_close(guided(x, step), expected, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(lazy(x, step), expected, rtol=1e-4, atol=1e-4)


def test_guidance_acts_in_its_interval_only():
    model, cond = randomised(), torch.randn(1, 5)
    sizes = []
    model.denoiser.networks[0].embed_motion.register_forward_hook(
        lambda module, inputs, output: sizes.append(inputs[0].shape[1])
    )
    model.sample(cond, 5, steps=10, guidance_interval=(200, 500))
    assert sizes == [2 if 200 <= step <= 500 else 1 for step in timesteps(10, "leading")]
    sizes.clear()
    model.sample(cond, 5, steps=10, guidance=1)
    assert sizes == [1] * 10


def test_guidance_of_one_is_the_conditional_network():
    model, cond, noise = randomised(), torch.randn(1, 5), torch.randn(1, 5, 12)
    one = model.sample(cond, 5, steps=1, guidance=1, x_T=noise)
    with torch.no_grad():
        expected = model.denoise(noise, torch.tensor([0]), cond)
    torch.testing.assert_close(one, expected, rtol=1e-4, atol=1e-5)


def test_a_constraint_is_exact_in_the_sample():
    model, cond = randomised(), torch.randn(1, 5)
    frozen = torch.randn(1, 9, 6)

    def keep_b(clean: torch.Tensor, step: int) -> torch.Tensor:
        return torch.cat([clean[..., :6], frozen], dim=-1)

    out = model.sample(cond, 9, steps=5, seed=0, constrain=keep_b)
    assert torch.equal(out[..., 6:], frozen)
    free = model.sample(cond, 9, steps=5, seed=0)
    assert (out - free)[..., :6].abs().max() > 1e-3


def test_normalising_and_back_changes_nothing():
    rng = np.random.default_rng(0)
    model = InterGen(TINY, mean=rng.normal(size=6), std=rng.uniform(0.1, 3, 6))
    raw = torch.randn(2, 4, 12)
    torch.testing.assert_close(model.denormalise(model.normalise(raw)), raw)
    one = model.normalise(raw)[..., 6:]
    torch.testing.assert_close(one, (raw[..., 6:] - model.mean) / model.std)
    torch.testing.assert_close(model.normalise(raw[..., 6:]), one)


@pytest.mark.parametrize(
    "statistics",
    [{"mean": np.zeros(5)}, {"std": np.zeros(6)}, {"mean": np.full(6, np.nan)}],
)
def test_statistics_that_do_not_fit_are_refused(statistics):
    with pytest.raises(SpecError):
        InterGen(TINY, **statistics)


@pytest.mark.parametrize(
    ("cond", "frames", "options"),
    [
        (torch.zeros(1, 4), 5, {}),
        (torch.zeros(1, 5), 0, {}),
        (torch.zeros(1, 5), 5001, {}),
        (torch.zeros(1, 5), 5, {"x_T": torch.zeros(1, 4, 12)}),
        (torch.zeros(1, 5), 5, {"steps": 0}),
    ],
)
def test_sampling_refuses_what_does_not_fit(cond, frames, options):
    with pytest.raises(SpecError):
        randomised().sample(cond, frames, **options)


def test_text_needs_an_encoder_of_the_right_width():
    with pytest.raises(CheckpointError, match="text=True"):
        randomised().encode_text(["hello"])
    model = randomised(text=LengthEncoder())
    torch.testing.assert_close(model.encode_text(["hello", ""])[0, 0], torch.tensor(0.5))
    wide = randomised(DenoiserConfig(16, 1, 2, 32, features=6, text_width=7), text=LengthEncoder())
    with pytest.raises(CheckpointError, match="width 5"):
        wide.encode_text(["hello"])


def test_a_sentence_becomes_a_duet_with_its_provenance(make_duet):
    features = encode(make_duet(frames=20)).reshape(-1, 262)
    config = DenoiserConfig(width=16, layers=1, heads=2, feedforward=32, text_width=5)
    provenance = Provenance("tiny", "CC0", 20.0)
    model = InterGen(
        config,
        mean=features.mean(0),
        std=np.full(262, 0.01),
        text=LengthEncoder(),
        provenance=provenance,
    )
    torch.nn.init.normal_(model.denoiser.networks[0].out.weight, std=0.02)
    duet = model.generate("two people bow", 12, seed=4, steps=3)
    assert (duet.frames, duet.fps, duet.text, duet.seed) == (12, 20.0, "two people bow", 4)
    assert (duet.source, duet.licence) == ("tiny", "CC0")
    again = model.generate("two people bow", 12, seed=4, steps=3)
    np.testing.assert_array_equal(duet.keypoints, again.keypoints)
    rough = model.generate("two people bow", 12, seed=4, steps=3, smoothing=0)
    jerk = [np.abs(np.diff(d.keypoints, n=2, axis=0)).mean() for d in (duet, rough)]
    assert jerk[0] < jerk[1]


def test_a_canonical_model_makes_a_duet_too(make_duet):
    features = to_canonical(encode(make_duet(frames=20))).reshape(-1, 267)
    config = DenoiserConfig(
        width=16, layers=1, heads=2, feedforward=32, features=267, text_width=5,
        representation="canonical",
    )  # fmt: skip
    model = InterGen(
        config, mean=features.mean(0), std=features.std(0) + 1e-3, text=LengthEncoder()
    )
    duet = model.generate("two people bow", 12, steps=2)
    assert duet.frames == 12
    assert np.linalg.norm(duet.a.keypoints - duet.b.keypoints, axis=-1).mean() > 0.1


def test_a_model_without_statistics_refuses_to_speak_of_metres():
    config = DenoiserConfig(width=16, layers=1, heads=2, feedforward=32, text_width=5)
    with pytest.raises(CheckpointError, match="statistics"):
        InterGen(config, text=LengthEncoder()).generate("two people bow", 12)


def test_an_empty_sentence_is_refused():
    with pytest.raises(PromptError):
        randomised(text=LengthEncoder()).generate("  ", 12)
