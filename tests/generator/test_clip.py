"""CLIP's text tower, the release's two further layers, and the tokenizer."""

from __future__ import annotations

import gzip
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from generator.release_keys import text_shapes
from generator.text.causal import CausalEncoder
from generator.text.clip import (
    ClipConfig,
    ClipEncoder,
    ClipTextTower,
    QuickGelu,
    sentence_end,
    tower_state,
)
from generator.text.clip_tokenizer import (
    PACKAGES,
    ClipTokenizer,
    _byte_letters,
    find_vocabulary,
)
from generator.text.release_text import ReleaseText, ReleaseTextHead
from robots.errors import CheckpointError

torch.set_num_threads(1)

TINY = ClipConfig(width=64, layers=2, heads=1, context=77, vocabulary=514 + 3)


def tiny_tower(seed: int = 0) -> ClipTextTower:
    torch.manual_seed(seed)
    tower = ClipTextTower(TINY)
    for value in tower.parameters():
        torch.nn.init.normal_(value, std=0.2)
    return tower.eval()


def write_vocabulary(path: Path) -> Path:
    """Write a vocabulary of CLIP's layout and number of merges, of which the first three count."""
    real = ["h e", "l l", "he ll"]
    letters = _byte_letters()
    rare = letters[188:]  # bytes that no test sentence holds
    pairs = [f"{a} {b}" for a in letters for b in rare]
    filler = [pair + end for pair in pairs for end in ("", "</w>")]
    filler += [f"{b} {a}" for a in letters[:188] for b in rare]
    filler += [f"{b} {a}</w>" for a in letters[:188] for b in rare]
    lines = ["header", *real, *filler[: 48894 - len(real)], "beyond the end"]
    with gzip.open(path, "wt") as file:
        file.write("\n".join(lines))
    return path


@pytest.fixture(scope="module")
def vocabulary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_vocabulary(tmp_path_factory.mktemp("clip") / "bpe_simple_vocab_16e6.txt.gz")


@pytest.mark.slow
def test_the_releases_text_path_is_at_parity(golden: Path):
    """Full size: CLIP's states, the trained layers' states and the condition vectors."""
    spec = importlib.util.spec_from_file_location("recipe", golden / "recipe.py")
    assert spec is not None
    assert spec.loader is not None
    recipe = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(recipe)
    state = {
        key: torch.from_numpy(recipe.value(key, shape))
        for key, shape in text_shapes(ClipConfig()).items()
    }
    text = ReleaseText.from_release_state(state, where="recipe")
    del state
    with np.load(golden / "text.npz") as archive:
        tokens = torch.from_numpy(archive["tokens"]).long()
        with torch.no_grad():
            states = text.tower(tokens)
            encoded = text.head.states(states)
            cond = text(tokens)
        np.testing.assert_array_equal(sentence_end(tokens), archive["eot"])
        np.testing.assert_allclose(states, archive["clip_out"], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(encoded, archive["encoded"], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(cond, archive["cond"], rtol=1e-4, atol=1e-4)


def test_tokens_are_at_parity_where_the_vocabulary_is_installed(golden: Path):
    try:
        path = find_vocabulary(None)
    except CheckpointError as error:
        pytest.skip(str(error))
    with np.load(golden / "text.npz") as archive:
        tokens = ClipTokenizer(path).encode([str(text) for text in archive["prompts"]])
        np.testing.assert_array_equal(tokens, archive["tokens"])


def test_merges_case_spaces_and_entities_are_treated_as_clip_does(vocabulary: Path):
    tokenizer = ClipTokenizer(vocabulary)
    # bytes 0..255, the same at a word's end 256..511, then merges: he, ll, hell
    he, ll, hell, start, end = 512, 513, 514, 49406, 49407
    byte = {letter: ord(letter) - 33 for letter in "abcdefghijklmnopqrstuvwxyz!'&s"}
    last = {letter: value + 256 for letter, value in byte.items()}
    rows = tokenizer.encode(["hello", "  HELLO\n\t hex ", "o's!", "&amp;amp;", ""])
    expected = [
        [start, hell, last["o"], end],
        [start, hell, last["o"], he, last["x"], end],
        [start, last["o"], byte["'"], last["s"], last["!"], end],
        [start, last["&"], end],
        [start, end],
    ]
    assert ll not in rows[0]
    for row, tokens in zip(rows, expected, strict=True):
        assert row[: len(tokens)].tolist() == tokens
        assert not row[len(tokens) :].any()


def test_a_long_sentence_loses_its_end_but_not_its_mark(vocabulary: Path):
    tokens = ClipTokenizer(vocabulary).encode(["a " * 200])[0]
    assert tokens[-1] == 49407
    assert (tokens[1:-1] == ord("a") - 33 + 256).all()
    assert sentence_end(torch.from_numpy(tokens[None])).item() == 76


def test_the_vocabulary_is_looked_for_in_folders_then_packages(
    vocabulary: Path, tmp_path: Path, monkeypatch
):
    assert find_vocabulary(vocabulary) == vocabulary
    assert find_vocabulary(None, vocabulary.parent) == vocabulary
    package = tmp_path / PACKAGES[0]
    package.mkdir()
    (package / "__init__.py").touch()
    found = package / vocabulary.name
    found.write_bytes(vocabulary.read_bytes())
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    assert find_vocabulary(None, tmp_path) == found
    with pytest.raises(CheckpointError, match="no such file"):
        find_vocabulary(tmp_path / "absent")


def test_a_missing_vocabulary_says_where_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CheckpointError, match="openai-clip"):
        find_vocabulary(None)
    encoder = ReleaseText(tiny_tower(), ReleaseTextHead(64, 1, hidden=8))
    with pytest.raises(CheckpointError, match="vocabulary"):
        encoder.encode(["hello"])


@pytest.mark.parametrize(
    "content",
    [b"", b"text", gzip.compress(b"header\na b\n", mtime=0)],
    ids=["empty", "text", "short"],
)
def test_a_damaged_vocabulary_is_an_error_of_ours(tmp_path: Path, content: bytes):
    for name in ("bpe_simple_vocab_16e6.txt.gz", "tokenizer.json"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(CheckpointError):
            ClipTokenizer(tmp_path / name)


def test_a_tokenizer_json_counts_the_same(vocabulary: Path, tmp_path: Path):
    tokenizer = ClipTokenizer(vocabulary)
    tokenizer._tokenizer.save(str(tmp_path / "tokenizer.json"))
    again = ClipTokenizer(tmp_path / "tokenizer.json")
    sentences = ["hello hell", "He's 12!"]
    np.testing.assert_array_equal(again.encode(sentences), tokenizer.encode(sentences))


@torch.no_grad()
def test_the_tower_is_causal():
    tower = tiny_tower()
    tokens = torch.randint(1, 500, (1, 10))
    other = tokens.clone()
    other[0, 6:] = 7
    torch.testing.assert_close(tower(tokens)[:, :6], tower(other)[:, :6])
    assert (tower(tokens) - tower(other))[:, 6:].abs().max() > 1e-3


@torch.no_grad()
def test_the_head_is_not_causal_and_sees_padding():
    head = ReleaseTextHead(64, 1, hidden=16).eval()
    states = torch.randn(1, 77, 64)
    tokens = torch.zeros(1, 77, dtype=torch.long)
    tokens[0, 3] = 9
    other = states.clone()
    other[0, 40] += 1
    assert (head(states, tokens) - head(other, tokens)).abs().max() > 1e-4


def test_quick_gelu_is_the_sigmoid_approximation():
    x = torch.linspace(-4, 4, 9)
    torch.testing.assert_close(QuickGelu()(x), x / (1 + torch.exp(-1.702 * x)))


def transformers_state(tower: ClipTextTower) -> dict[str, torch.Tensor]:
    """The same weights under the names of the transformers library."""
    names = {"ln_1": "layer_norm1", "ln_2": "layer_norm2", "mlp.c_fc": "mlp.fc1",
             "mlp.c_proj": "mlp.fc2", "attn.out_proj": "self_attn.out_proj"}  # fmt: skip
    state = {}
    for key, value in tower.state_dict().items():
        if not key.startswith("resblocks."):
            continue
        _, index, rest = key.split(".", 2)
        prefix = f"text_model.encoder.layers.{index}."
        if ".in_proj_" in rest:
            for name, part in zip("qkv", value.chunk(3), strict=True):
                state[f"{prefix}self_attn.{name}_proj.{rest.rsplit('_', 1)[1]}"] = part
        else:
            inner, kind = rest.rsplit(".", 1)
            state[f"{prefix}{names[inner]}.{kind}"] = value
    own = tower.state_dict()
    return state | {
        "text_model.embeddings.token_embedding.weight": own["token_embedding.weight"],
        "text_model.embeddings.position_embedding.weight": own["positional_embedding"],
        "text_model.embeddings.position_ids": torch.arange(77)[None],
        "text_model.final_layer_norm.weight": own["ln_final.weight"],
        "text_model.final_layer_norm.bias": own["ln_final.bias"],
        "vision_model.something": torch.zeros(3),
        "text_projection.weight": torch.zeros(3, 3),
    }


def openai_state(tower: ClipTextTower, prefix: str) -> dict[str, torch.Tensor]:
    state = {
        key.replace("resblocks.", f"{prefix}resblocks.", 1): value
        for key, value in tower.state_dict().items()
    }
    return state | {"visual.transformer.resblocks.0.ln_1.weight": torch.zeros(2)}


@torch.no_grad()
@pytest.mark.parametrize("naming", ["openai", "release", "transformers"])
def test_weights_are_read_in_every_common_naming(naming: str):
    tower = tiny_tower()
    if naming == "transformers":
        state = transformers_state(tower)
    else:
        state = openai_state(tower, "transformer." if naming == "openai" else "clip_transformer.")
    again = ClipTextTower.from_state(state, where="memory")
    tokens = torch.randint(1, 500, (2, 77))
    torch.testing.assert_close(again(tokens), tower(tokens), rtol=1e-5, atol=1e-5)
    assert not any(value.requires_grad for value in again.parameters())
    assert set(tower_state(state)) == set(tower.state_dict())


def test_a_tower_that_lacks_a_key_is_refused_by_name():
    state = openai_state(tiny_tower(), "transformer.")
    del state["transformer.resblocks.1.mlp.c_fc.bias"]
    with pytest.raises(CheckpointError, match=r"resblocks\.1\.mlp\.c_fc\.bias"):
        ClipTextTower.from_state(state, where="memory")
    with pytest.raises(CheckpointError, match="token_embedding"):
        ClipTextTower.from_state({}, where="memory")


@pytest.mark.parametrize("suffix", [".safetensors", ".pt"])
def test_clip_from_a_folder_encodes_sentences(vocabulary: Path, tmp_path: Path, suffix: str):
    from safetensors.torch import save_file

    torch.manual_seed(0)
    tower = ClipTextTower(ClipConfig(64, 1, 1, 77, 49408)).eval()
    torch.nn.init.normal_(tower.positional_embedding)
    state = openai_state(tower, "transformer.")
    if suffix == ".pt":
        torch.save(state, tmp_path / "clip.pt")
    else:
        save_file(state, tmp_path / "clip.safetensors")
    (tmp_path / vocabulary.name).write_bytes(vocabulary.read_bytes())
    encoder = ClipEncoder.from_folder(tmp_path)
    vectors = encoder.encode(["hello", "hex", "hello"])
    assert vectors.shape == (3, encoder.dimension)
    assert vectors.dtype == np.float32
    np.testing.assert_allclose(vectors[0], vectors[2], rtol=1e-5)
    assert np.abs(vectors[0] - vectors[1]).max() > 1e-3
    with torch.no_grad():
        tokens = torch.from_numpy(encoder.tokenizer.encode(["hello"]))
        np.testing.assert_allclose(vectors[0], tower(tokens)[0, 3], rtol=1e-4, atol=1e-5)


def test_a_folder_without_weights_is_an_error_of_ours(tmp_path: Path):
    with pytest.raises(CheckpointError, match="weights"):
        ClipEncoder.from_folder(tmp_path)
    with pytest.raises(CheckpointError, match="folder"):
        ClipEncoder.from_folder(tmp_path / "absent")
    (tmp_path / "clip.safetensors").write_bytes(b"junk")
    with pytest.raises(CheckpointError, match="cannot be read"):
        ClipEncoder.from_folder(tmp_path)


def test_a_language_model_without_its_library_says_what_to_install(tmp_path: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(CheckpointError, match="pip install transformers"):
        CausalEncoder(tmp_path)
    with pytest.raises(CheckpointError, match="no such folder"):
        CausalEncoder(tmp_path / "absent")


class FakeLanguageModel:
    """The part of transformers' interface that is used: a state says its layer and its token."""

    class config:  # noqa: N801 - the library's name
        hidden_size = 3

    def eval(self) -> FakeLanguageModel:
        return self

    def requires_grad_(self, _: bool) -> FakeLanguageModel:
        return self

    def __call__(self, input_ids: torch.Tensor, output_hidden_states: bool) -> object:
        assert output_hidden_states
        layers = [
            torch.stack([input_ids, torch.full_like(input_ids, i), input_ids * i], -1).float()
            for i in range(5)
        ]
        return type("Output", (), {"hidden_states": layers})


def test_the_last_tokens_penultimate_state_is_taken(tmp_path: Path, monkeypatch):
    library = ModuleType("transformers")
    calls = []

    class Loader:
        def __init__(self, made: object) -> None:
            self.made = made

        def from_pretrained(self, folder: str, **options: object) -> object:
            calls.append(options)
            if not (Path(folder) / "config.json").is_file():
                raise OSError("no config\nmore")
            return self.made

    def tokenizer(sentence: str, **options: object) -> dict[str, torch.Tensor]:
        assert options["max_length"] == 4
        return {"input_ids": torch.tensor([[len(word) for word in sentence.split()][:4]])}

    library.AutoTokenizer = Loader(tokenizer)  # type: ignore[attr-defined]
    library.AutoModel = Loader(FakeLanguageModel())  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "transformers", library)
    with pytest.raises(CheckpointError, match="no config"):
        CausalEncoder(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps({}))
    encoder = CausalEncoder(tmp_path, longest=4)
    assert all(c["local_files_only"] and c["trust_remote_code"] is False for c in calls)
    np.testing.assert_array_equal(
        encoder.encode(["two people dance", "a b c dddd ee"]), [[5, 3, 15], [4, 3, 12]]
    )
    assert encoder.dimension == 3
