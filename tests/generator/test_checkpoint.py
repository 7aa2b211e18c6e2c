"""Models on disk: the public release's file, and this project's own folders."""

from __future__ import annotations

import json
import logging
import pickle
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch

from generator import checkpoint, weights
from generator.architecture import DenoiserConfig
from generator.checkpoint import load, load_release, save
from generator.model import InterGen
from generator.provenance import Provenance
from generator.release_keys import DUPLICATE, TABLES, denoiser_shapes, text_shapes
from generator.text.clip import ClipConfig, ClipTextTower
from generator.text.release_text import ReleaseText, ReleaseTextHead
from robots.errors import CheckpointError

torch.set_num_threads(1)

TINY = DenoiserConfig(width=16, layers=2, heads=2, feedforward=32, features=6, text_width=5)


def release_value(name: str, shape: tuple[int, ...]) -> torch.Tensor:
    """Seeded numbers for one key; the same for the same name and shape."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    scale = 1 / np.sqrt(np.prod(shape[1:])) if len(shape) > 1 else 0.05
    return torch.from_numpy((scale * rng.standard_normal(shape)).astype(np.float32))


def release_state(config: DenoiserConfig) -> dict[str, torch.Tensor]:
    """A state like the release's, of any size, with Lightning's prefix."""
    state = {f"model.{k}": release_value(k, s) for k, s in denoiser_shapes(config).items()}
    table = InterGen(config).denoiser.positions.clone()
    return state | {f"model.{key}": table.clone() for key in TABLES}


def write(path: Path, state: object) -> Path:
    torch.save({"epoch": 0, "state_dict": state}, path)
    return path


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    return write(tmp_path / "tiny.ckpt", release_state(TINY))


def randomised(seed: int = 0, **options: object) -> InterGen:
    torch.manual_seed(seed)
    model = InterGen(TINY, **options)  # type: ignore[arg-type]
    for value in model.parameters():
        torch.nn.init.normal_(value, std=0.3)
    return model.eval()


def test_key_list_is_at_parity_with_the_release(golden: Path):
    expected = json.loads((golden / "state_dict_keys.json").read_text())["intergen"]
    own = denoiser_shapes(DenoiserConfig()) | text_shapes(ClipConfig())
    assert {key: list(shape) for key, shape in own.items()} == expected
    assert len(own) == 346


def test_key_list_of_the_small_model_is_at_parity(golden: Path):
    content = json.loads((golden / "state_dict_keys_small.json").read_text())
    expected = content.get("intergen", content)
    own = denoiser_shapes(DenoiserConfig(width=64, feedforward=128)) | text_shapes(ClipConfig())
    ours = {key: list(shape) for key, shape in own.items()}
    different = {key for key in expected if ours.get(key) != expected[key]}
    assert set(ours) == set(expected)
    assert not different


def test_sizes_come_from_the_shapes(tiny: Path):
    model = load_release(tiny, heads=2)
    assert model.config == TINY
    assert not model.training


def test_a_loaded_release_gives_the_same_as_its_tensors_by_name(tiny: Path):
    """An unlike path: two of the release's layers computed straight from the file's tensors."""
    state = release_state(TINY)
    denoiser = load_release(tiny, heads=2).denoiser
    t, cond = torch.tensor([7]), torch.randn(1, 5)

    def linear(x: torch.Tensor, name: str) -> torch.Tensor:
        name = f"model.decoder.net.{name}"
        return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]

    time = linear(denoiser.positions[t], "embed_timestep.time_embed.0")
    time = linear(torch.nn.functional.silu(time), "embed_timestep.time_embed.2")
    emb = torch.nn.functional.silu(time + linear(cond, "text_embed"))
    names = ["sa_block.norm", "ffn.norm", "ca_block.norm", "ca_block.xf_norm"]
    expected = [linear(emb, f"blocks.1.{name}.emb_layers.1") for name in names]
    torch.testing.assert_close(
        denoiser.modulations(t, denoiser.read(cond))[0, 1], torch.cat(expected, dim=-1)
    )
    packed = state["model.decoder.net.blocks.1.ca_block.attention.in_proj_weight"]
    attention = denoiser.networks[0].blocks[1].mutual_attention
    assert torch.equal(attention.query.weight, packed[:16])
    assert torch.equal(attention.key_value.weight, packed[16:])


def test_duplicates_of_the_sampler_are_tolerated(tmp_path: Path):
    state = release_state(TINY)
    prefix = "model.decoder.net."
    state |= {
        f"model.{DUPLICATE}model.{key.removeprefix(prefix)}": value
        for key, value in list(state.items())
    }
    model = load_release(write(tmp_path / "sampled.ckpt", state), heads=2)
    assert torch.isfinite(model.sample(torch.randn(1, 5), 4, steps=2)).all()


@pytest.mark.parametrize(
    "key", ["blocks.1.ffn.linear2.bias", "motion_embed.weight", "out.linear.bias"]
)
def test_a_missing_key_is_named(tmp_path: Path, key: str):
    state = release_state(TINY)
    del state[f"model.decoder.net.{key}"]
    with pytest.raises(CheckpointError, match=key):
        load_release(write(tmp_path / "cut.ckpt", state), heads=2)


@pytest.mark.parametrize("key", sorted(denoiser_shapes(TINY)))
def test_a_wrong_shape_is_named(tmp_path: Path, key: str):
    state = release_state(TINY)
    value = state[f"model.{key}"]
    state[f"model.{key}"] = torch.cat([value, value])
    if key.endswith("pe"):
        state[f"model.{key}"] = value[:100]
    with pytest.raises(CheckpointError, match="shape"):
        load_release(write(tmp_path / "wrong.ckpt", state), heads=2)


def test_an_unknown_key_is_named(tmp_path: Path):
    state = release_state(TINY) | {"model.decoder.net.extra.weight": torch.zeros(2)}
    with pytest.raises(CheckpointError, match=r"extra\.weight"):
        load_release(write(tmp_path / "more.ckpt", state), heads=2)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_named(tmp_path: Path, bad: float):
    state = release_state(TINY)
    state["model.decoder.net.blocks.0.sa_block.attention.in_proj_weight"][3, 2] = bad
    with pytest.raises(CheckpointError, match="in_proj_weight"):
        load_release(write(tmp_path / "nan.ckpt", state), heads=2)


def test_another_table_of_positions_is_refused(tmp_path: Path):
    state = release_state(TINY)
    state[f"model.{TABLES[1]}"] += 0.1
    with pytest.raises(CheckpointError, match="embed_timestep"):
        load_release(write(tmp_path / "pe.ckpt", state), heads=2)


class Bomb:
    """Writes a file when unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.touch, (self.target,)


@pytest.mark.parametrize("way", ["torch", "pickle"])
def test_a_pickle_payload_is_refused_and_not_run(tmp_path: Path, way: str):
    target, file = tmp_path / "ran", tmp_path / "bomb.ckpt"
    content = {"state_dict": release_state(TINY), "payload": Bomb(target)}
    if way == "torch":
        torch.save(content, file)
    else:
        file.write_bytes(pickle.dumps(content["payload"]))
    with pytest.raises(CheckpointError):
        load_release(file, heads=2)
    assert not target.exists()


@pytest.mark.parametrize("content", [b"", b"PK\3\4 nothing", b"hello", b"\x80\x02."])
def test_a_damaged_file_is_an_error_of_ours(tmp_path: Path, content: bytes):
    file = tmp_path / "damaged.ckpt"
    file.write_bytes(content)
    with pytest.raises(CheckpointError):
        load_release(file)


def test_a_file_cut_short_is_an_error_of_ours(tiny: Path, tmp_path: Path):
    data = tiny.read_bytes()
    for share in (0.1, 0.5, 0.99):
        file = tmp_path / f"short{share}.ckpt"
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(CheckpointError):
            load_release(file, heads=2)


def test_a_missing_file_is_an_error_of_ours(tmp_path: Path):
    with pytest.raises(CheckpointError, match="no such file"):
        load_release(tmp_path / "absent.ckpt")


def test_statistics_beside_the_checkpoint_are_taken(tiny: Path):
    rng = np.random.default_rng(0)
    mean, std = rng.normal(size=6).astype(np.float32), rng.uniform(1, 2, 6).astype(np.float32)
    np.save(tiny.parent / "global_mean.npy", mean)
    np.save(tiny.parent / "global_std.npy", std)
    model = load_release(tiny, heads=2)
    np.testing.assert_array_equal(model.mean, mean)
    np.testing.assert_array_equal(model.std, std)
    np.save(tiny.parent / "global_std.npy", 0 * std)
    with pytest.raises(CheckpointError, match="positive"):
        load_release(tiny, heads=2)
    with pytest.raises(CheckpointError, match="no such file"):
        load_release(tiny, heads=2, statistics=tiny.parent / "elsewhere")


def test_the_licence_is_said_once_and_kept(tiny: Path, tmp_path: Path, caplog):
    checkpoint._warn_of_licence.cache_clear()
    with caplog.at_level(logging.WARNING):
        model = load_release(tiny, heads=2)
        save(model, tmp_path / "own")
        again = load(tmp_path / "own")
    notices = [r for r in caplog.records if "CC BY-NC-SA" in r.getMessage()]
    assert len(notices) == 1
    assert model.licence == again.licence == "CC BY-NC-SA 4.0"


def test_a_saved_model_comes_back_the_same(tmp_path: Path):
    provenance = Provenance("mine", "CC0", 20.0, {"steps": 7, "losses": [1.0, 0.5]})
    model = randomised(provenance=provenance, mean=np.arange(6.0), std=np.arange(1.0, 7.0))
    digest = save(model, tmp_path / "model")
    again = load(tmp_path / "model")
    assert again.config == model.config
    assert again.provenance == provenance
    assert len(digest) == 64
    cond = torch.randn(2, 5)
    assert torch.equal(
        model.sample(cond, 9, seed=3, steps=4), again.sample(cond, 9, seed=3, steps=4)
    )
    assert torch.equal(model.std, again.std)


def test_saving_again_replaces_the_old_weights(tmp_path: Path):
    save(randomised(0), tmp_path)
    save(randomised(1), tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    expected = randomised(1).denoiser.networks[0].out.weight
    assert torch.equal(load(tmp_path).denoiser.networks[0].out.weight, expected)


def test_a_crash_while_saving_leaves_the_old_model(tmp_path: Path, monkeypatch):
    save(randomised(0), tmp_path)

    def crash(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(weights, "write_json", crash)
    with pytest.raises(CheckpointError, match="disk full"):
        save(randomised(1), tmp_path)
    expected = randomised(0).denoiser.networks[0].out.weight
    assert torch.equal(load(tmp_path).denoiser.networks[0].out.weight, expected)


def test_damage_in_an_own_folder_is_named(tmp_path: Path):
    save(randomised(), tmp_path)
    header = json.loads((tmp_path / "model.json").read_text())
    file = tmp_path / header["weights"]["file"]
    data = file.read_bytes()
    file.write_bytes(data[:-4] + b"\0\0\0\1")
    with pytest.raises(CheckpointError, match="SHA-256"):
        load(tmp_path)
    file.unlink()
    with pytest.raises(CheckpointError, match="no such file"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h["architecture"].update(widht=3), "width"),
        (lambda h: h["architecture"].update(heads=5), "heads"),
        (lambda h: h["architecture"].update(layers=3), "blocks.2"),
        (lambda h: h["architecture"].update(features=7), "shape"),
        (lambda h: h.update(version=9), "version"),
        (lambda h: h.update(format="other"), "format"),
        (lambda h: h["weights"].update(file="../../etc/passwd"), "names no weights"),
        (lambda h: h.update(text_encoder="Oracle"), "Oracle"),
        (lambda h: h.pop("provenance"), "Provenance"),
    ],
)
def test_a_header_that_does_not_fit_is_an_error_of_ours(tmp_path: Path, change, message: str):
    save(randomised(), tmp_path)
    path = tmp_path / "model.json"
    header = json.loads(path.read_text())
    change(header)
    path.write_text(json.dumps(header))
    with pytest.raises(CheckpointError, match=message):
        load(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{", "nul"])
def test_a_header_that_is_not_json_is_an_error_of_ours(tmp_path: Path, text: str):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(CheckpointError):
        load(tmp_path)


def test_the_text_path_is_saved_with_the_model(tmp_path: Path):
    torch.manual_seed(0)
    tower = ClipTextTower(ClipConfig(64, 1, 1, 77, 60))
    torch.nn.init.normal_(tower.positional_embedding)
    head = ReleaseTextHead(64, layers=1, hidden=8)
    config = DenoiserConfig(16, 1, 2, 32, features=6, text_width=64)
    model = InterGen(config, text=ReleaseText(tower, head).eval())
    save(model, tmp_path)
    again = load(tmp_path).text
    tokens = torch.randint(60, (2, 77))
    assert isinstance(again, ReleaseText)
    assert torch.equal(again(tokens), model.text(tokens))  # type: ignore[misc]
    assert load(tmp_path, text=False).text is None
    assert not any(name.startswith("text") for name, _ in model.named_parameters())


@pytest.mark.slow
def test_a_full_size_release_loads_strictly_and_samples(golden: Path, tmp_path: Path):
    import importlib.util

    spec = importlib.util.spec_from_file_location("recipe", golden / "recipe.py")
    assert spec is not None
    assert spec.loader is not None
    recipe = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(recipe)
    config = DenoiserConfig()
    table = InterGen(DenoiserConfig(layers=1)).denoiser.positions
    state = {
        f"model.{key}": table if key in TABLES else torch.from_numpy(recipe.value(key, shape))
        for key, shape in denoiser_shapes(config).items()
    }
    file = write(tmp_path / "full.ckpt", state)
    del state
    model = load_release(file)
    assert sum(value.numel() for value in model.parameters()) == pytest.approx(171.35e6, rel=1e-3)
    drawn = model.sample(torch.randn(1, 768), 30, steps=2, seed=0)
    assert drawn.shape == (1, 30, 524)
    assert torch.isfinite(drawn).all()
