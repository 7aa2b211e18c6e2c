"""Models without torch: the same motions, checked files, and nothing of torch imported."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from generator import checkpoint
from generator.architecture import DenoiserConfig
from generator.diffusion import SamplerConfig
from generator.model import InterGen
from generator.model_folder import HEADER
from generator.provenance import Provenance
from generator.runtime import DiffusionRequest, Network, Portable, Sampling, draw, generate
from generator.runtime.generation import chosen_folder
from generator.runtime.portable import PRECISIONS
from generator.text.encoder import packaged_encoder
from generator.training.card import CARD
from generator.training.portable import require_agreement, rounded, write_network, write_portable
from robots.errors import CheckpointError, PromptError, SpecError

torch.set_num_threads(1)
FRAMES = 40


def random_model(seed: int = 0, **changes) -> InterGen:
    """A small model all of whose layers do something (fresh ones end in zeros)."""
    sizes = {"width": 32, "layers": 2, "heads": 2, "feedforward": 48, "dropout": 0.0}
    torch.manual_seed(seed)
    model = InterGen(
        DenoiserConfig(**{**sizes, "text_width": 384, **changes}),
        mean=np.linspace(-0.5, 0.5, 262),
        std=np.linspace(0.1, 0.3, 262),
        text=packaged_encoder("minilm-tokens" if "text_tokens" in changes else "minilm"),
        provenance=Provenance("small", "CC0", 15.0, {"frames": FRAMES}),
    )
    with torch.no_grad():
        for parameter in model.denoiser.parameters():
            if parameter.dim() > 1:
                parameter.normal_(std=parameter.shape[1] ** -0.5)
    return model.eval()


def inputs(batch: int, frames: int, width: int = 384, seed: int = 0):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((batch, frames, 524), np.float32)
    cond = rng.standard_normal((batch, width), np.float32)
    return x, rng.integers(0, 1000, batch), cond / np.linalg.norm(cond, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("portable")
    model = random_model()
    for precision in PRECISIONS:
        write_portable(model, root / precision, frames=FRAMES, precision=precision)
    return {precision: root / precision for precision in PRECISIONS}


VARIANTS = [
    {},
    {"conditioning": "concat"},
    {"share_weights": False},
    {"text_width": 40 * 384, "text_tokens": 40},
    {"told_apart": True},
    {"told_apart": True, "text_width": 40 * 385, "text_tokens": 40, "text_names": True},
]


@pytest.mark.parametrize(
    "changes", VARIANTS, ids=["plain", "concat", "unshared", "tokens", "apart", "names"]
)
@torch.no_grad()
def test_the_network_predicts_what_torch_predicts(changes, tmp_path):
    model = random_model(**changes)
    write_network(model.denoiser, tmp_path / "n.onnx", frames=FRAMES)
    network = Network(tmp_path / "n.onnx")
    width = model.config.text_width
    for batch, frames in ((1, 2), (3, 17), (2, FRAMES)):
        x, t, cond = inputs(batch, frames, width)
        if "text_tokens" in changes:
            cond[:, 9 * width // 40 :] = 0  # sentences end
        cond[-1] = 0  # the branch without a text
        truth = model.denoise(*map(torch.from_numpy, (x, t, cond))).numpy()
        assert np.abs(truth).max() > 0.5
        np.testing.assert_allclose(network(x, t, cond), truth, atol=1e-4)


@torch.no_grad()
def test_storing_in_half_the_bytes_loses_nothing_more_and_eight_bits_lose_little(folders):
    x, t, cond = inputs(2, 30)
    truth = checkpoint.load(folders["int8"]).denoise(*map(torch.from_numpy, (x, t, cond))).numpy()
    scale = np.sqrt((truth**2).mean())
    sizes, errors = {}, {}
    for precision, folder in folders.items():
        model = Portable.load(folder)
        error = model.network(x, t, cond) - truth
        errors[precision] = float(np.sqrt((error**2).mean()) / scale)
        sizes[precision] = next(folder.glob("network-*")).stat().st_size
    assert errors["float32"] < 1e-5
    assert errors["float16"] < 1e-5
    assert 1e-4 < errors["int8"] < 0.05, "eight bits are not used, or too few"
    assert sizes["int8"] < sizes["float16"] + 100_000 < sizes["float32"] + 100_000


@pytest.mark.parametrize("solver", ["ddim", "dpm2m"])
@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_motions_are_those_that_torch_draws(folders, solver, guidance):
    interval = (100, 900)
    config = SamplerConfig(solver, 6, "trailing", guidance=guidance, guidance_interval=interval)
    noise, _, cond = inputs(2, 24)
    without = draw(Portable.load(folders["float16"]), cond, 24, config, noise=noise)
    model = checkpoint.load(folders["float16"])
    drawn = model.sample(
        torch.from_numpy(cond),
        24,
        steps=6,
        guidance=guidance,
        solver=solver,
        spacing="trailing",
        guidance_interval=interval,
        x_T=torch.from_numpy(noise),
    )
    truth = model.denormalise(drawn).unflatten(-1, (2, 262)).numpy()
    np.testing.assert_allclose(without, truth, atol=1e-3)


def test_fresh_noise_follows_the_seed(folders):
    model = Portable.load(folders["float32"])
    cond = inputs(1, 1)[2]
    config = SamplerConfig("ddim", 4, eta=1.0, guidance=1)
    first, again, other = (draw(model, cond, 10, config, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    with pytest.raises(SpecError, match="shape"):
        draw(model, cond[:, :100], 10)


def test_a_sentence_becomes_a_duet_with_its_origin(folders):
    request = DiffusionRequest(weights=str(folders["int8"]), seconds=1.0, steps=2)
    motion, facts = generate("two people wave", request, seed=3)
    assert (motion.frames, motion.fps, motion.text, motion.seed) == (15, 15.0, "two people wave", 3)
    assert (motion.source, motion.licence) == ("small", "CC0")
    assert (facts["steps"], facts["guidance"]) == (2, Sampling(frames=2).guidance)
    again, _ = generate("two people wave", request, seed=3)
    np.testing.assert_array_equal(motion.keypoints, again.keypoints)
    other, _ = generate("one person pushes the other", request, seed=3)
    assert not np.allclose(motion.keypoints, other.keypoints)
    with pytest.raises(PromptError):
        generate("  ", request)
    for wrong in ({"seconds": 4000.0}, {"frames": 1}, {"frames": 30, "seconds": 1.0}):
        with pytest.raises(SpecError, match=r"frames|--seconds"):
            replace(request, **{"seconds": None, **wrong})
    with pytest.raises(SpecError, match="up to 100000"):
        generate("they wave", replace(request, seconds=None, frames=200_000))


def test_the_reading_layers_know_who_does_it(tmp_path):
    """The mean of a sentence hardly tells *A pushes B* from *B pushes A*; its tokens do."""
    encoder = packaged_encoder("minilm-tokens")
    assert encoder is not None
    one, other = encoder.encode(["A pushes B", "B pushes A"]).reshape(2, 40, 384)
    ends = [(rows != 0).any(-1).sum() for rows in (one, other)]
    assert ends[0] == ends[1] < 10, "what is not there is not zero"
    means = [rows[: ends[0]].mean(0) for rows in (one, other)]
    cosine = means[0] @ means[1] / np.linalg.norm(means[0]) / np.linalg.norm(means[1])
    assert cosine > 0.95
    assert np.abs(one - other).max() > 0.3


DAMAGES = {
    "network": (lambda f: next(f.glob("network-*")).write_bytes(b"no network"), "SHA-256"),
    "gone": (lambda f: next(f.glob("network-*")).unlink(), "no such file"),
    "header": (lambda f: (f / HEADER).write_text("{"), "cannot be read"),
    "statistics": (lambda f: change(f, statistics={"mean": [0.0], "std": [1.0]}), "mean"),
    "deviation": (
        lambda f: change(f, statistics={"mean": [0.0] * 262, "std": [0.0] * 262}),
        "positive",
    ),
    "sampling": (lambda f: change(f, sampling={"frames": 40, "stesp": 3}), "stesp"),
    "format": (lambda f: change(f, format="other"), "format"),
    "path": (lambda f: change(f, network={"file": "../x.onnx", "sha256": ""}), "names no network"),
    "torch only": (lambda f: change(f, network=None), "without torch"),
}


def change(folder: Path, **entries) -> None:
    header = json.loads((folder / HEADER).read_text())
    header |= entries
    header = {key: value for key, value in header.items() if value is not None}
    (folder / HEADER).write_text(json.dumps(header))


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_model_is_named_and_not_used(folders, tmp_path, damage):
    folder = tmp_path / "m"
    folder.mkdir()
    for file in folders["int8"].iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    Portable.load(folder)
    spoil, message = DAMAGES[damage]
    spoil(folder)
    with pytest.raises(CheckpointError, match=message):
        Portable.load(folder)


def test_a_network_of_something_else_is_refused(tmp_path):
    from generator.text.encoder import MODEL_FILE, _packaged_model

    assert _packaged_model().name == MODEL_FILE
    with pytest.raises(CheckpointError, match="takes"):
        Network(_packaged_model())
    (tmp_path / "x.onnx").write_bytes(b"\0" * 100)
    with pytest.raises(CheckpointError, match="cannot be read"):
        Network(tmp_path / "x.onnx")


def test_a_network_that_differs_from_its_model_is_not_written(tmp_path):
    model, other = rounded(random_model()), random_model(seed=1)
    write_network(other.denoiser, tmp_path / "n.onnx", frames=FRAMES)
    with pytest.raises(CheckpointError, match="off by"):
        require_agreement(model.denoiser, Network(tmp_path / "n.onnx"), 0.2)
    assert require_agreement(other.denoiser, Network(tmp_path / "n.onnx"), 1e-3) < 1e-5


def test_writing_again_replaces_the_old_model(tmp_path):
    for seed in (0, 1):
        path = write_portable(random_model(seed), tmp_path, frames=FRAMES)
    assert [file.name for file in tmp_path.glob("network-*")] == [path.name]
    assert len(list(tmp_path.iterdir())) == 4
    card = (tmp_path / CARD).read_text()
    assert "CC0" in card
    assert "15 frames per second, up to 2.7 s" in card
    with pytest.raises(SpecError, match="precision"):
        write_portable(random_model(), tmp_path, frames=FRAMES, precision="int4")  # type: ignore[arg-type]


def test_without_a_model_of_its_own_the_package_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setattr("generator.model_folder.SHIPPED", tmp_path / "none")
    with pytest.raises(CheckpointError, match="no model ships"):
        chosen_folder("")


def test_nothing_of_torch_is_imported(folders):
    code = f"""
import sys
class NotInstalled:
    def find_spec(self, name, *rest):
        if name.partition(".")[0] in ("torch", "onnx", "safetensors"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, NotInstalled())
from generator.runtime import DiffusionRequest, generate
request = DiffusionRequest(weights={str(folders["int8"])!r}, frames=12, steps=2)
motion, _ = generate("two people bow", request)
assert motion.frames == 12
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
