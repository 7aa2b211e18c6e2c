"""Packing a run, and the generator that a packed model makes the default."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from bridge.generating import default_generator, make
from bridge.run import RunSettings
from generator import model_folder
from generator.io import read_motion
from generator.model_folder import HEADER, read_header

torch = pytest.importorskip("torch")

FOREIGN = "the stock market fell by three percent on monday"
SAMPLING = (
    *("--solver", "ddim", "--steps", "3", "--guidance", "1.5"),
    *("--guidance-interval", "300", "999", "--spacing", "leading"),
)
CONFIG = """
[[data.source]]
kind = "choreographed"
count = 5
"""
OTHERS = """
[[data.source]]
kind = "duets"
root = "somewhere"
"""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of random weights on the choreographer's duets, as training would have left it."""
    from generator import checkpoint
    from generator.architecture import DenoiserConfig
    from generator.model import InterGen
    from generator.provenance import Provenance
    from generator.text.encoder import packaged_encoder

    torch.manual_seed(0)
    facts = {"data": ["5 choreographed duets, seed 0"], "text": "minilm", "frames": 30}
    model = InterGen(
        DenoiserConfig(width=16, layers=1, heads=2, feedforward=16, text_width=384),
        mean=np.zeros(262),
        std=np.full(262, 0.1),
        text=packaged_encoder("minilm"),
        provenance=Provenance("tiny", "CC0-1.0", 15.0, {**facts, "steps": 5, "of": 9}),
    )
    folder = tmp_path_factory.mktemp("run")
    checkpoint.save(model, folder)
    (folder / "config.toml").write_text(CONFIG)
    return folder


@pytest.fixture(scope="module")
def packed(run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("packed") / "model"
    assert main(["pack", str(run_folder), "-o", str(out), "--precision", "int8", *SAMPLING]) == 0
    return out


@pytest.fixture
def shipped(packed: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The packed model as that of the package."""
    monkeypatch.setattr(model_folder, "SHIPPED", packed)
    return packed


@pytest.mark.slow
def test_packing_again_leaves_the_same_model_with_what_was_measured(
    run_folder: Path, packed: Path, tmp_path: Path, capsys
) -> None:
    figures = tmp_path / "figures.json"
    figures.write_text('{"about": "By hand.", "columns": {"test": {"FID": 0.25}}}')
    words = ["pack", str(run_folder), "-o", str(tmp_path / "m"), "--precision", "int8", *SAMPLING]
    capsys.readouterr()
    assert main([*words, "--figures", str(figures), "--json"]) == 0
    sizes = json.loads(capsys.readouterr().out)["bytes"]
    assert sizes == {file.name: file.stat().st_size for file in (tmp_path / "m").iterdir()}
    first, second = read_header(packed), read_header(tmp_path / "m")
    assert first == second
    assert second["sampling"] == {
        **{"frames": 30, "solver": "ddim", "steps": 3, "spacing": "leading"},
        **{"guidance": 1.5, "guidance_interval": [300, 999]},
    }
    assert second["network"]["precision"] == "int8"
    cards = [(folder / "MODEL_CARD.md").read_text() for folder in (packed, tmp_path / "m")]
    assert "Not measured" in cards[0]
    assert "By hand." in cards[1]
    assert "| FID | 0.25 |" in cards[1]
    for card in cards:
        for said in ("CC0-1.0", "5 choreographed duets", "5 of 9 steps", "ddim", "refused"):
            assert said in card
    figures.write_text('{"about": "By hand."}')
    assert main([*words, "--figures", str(figures)]) == 2
    assert "columns" in capsys.readouterr().err


def test_a_model_that_learnt_from_other_motions_too_answers_for_any_sentence(
    run_folder: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    (run / "config.toml").write_text(CONFIG + OTHERS)
    assert main(["pack", str(run), "-o", str(tmp_path / "m")]) == 0
    assert read_header(tmp_path / "m")["repertoire"] is False
    words = ["generate", FOREIGN, "--generator", "diffusion", "--weights", str(tmp_path / "m")]
    assert main([*words, "-o", str(tmp_path / "x.npz"), "--steps", "1", "--raw"]) == 0


def test_the_default_is_the_model_where_one_ships(shipped: Path, monkeypatch, tmp_path) -> None:
    assert default_generator() == "diffusion"
    assert RunSettings(source="they bow", out=tmp_path).generator == "diffusion"
    monkeypatch.setattr(model_folder, "SHIPPED", tmp_path / "none")
    assert default_generator() == "choreographer"
    assert RunSettings(source="they bow", out=tmp_path).generator == "choreographer"
    _, facts = make("two people bow")
    assert facts["generator"] == "choreographer"


def test_the_shipped_model_is_asked_unless_another_generator_is(
    shipped: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "m.npz"
    words = ["generate", "two people bow", "-o", str(out), "--seconds", "1"]
    assert main([*words, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["generator"], facts["weights"]) == ("diffusion", "shipped")
    assert (facts["steps"], facts["guidance"]) == (3, 1.5)
    assert facts["understood"][0]["interaction"] == "bow"
    assert "drawn_as" not in facts
    assert main(words) == 0
    assert "tiny by diffusion, bow" in " ".join(capsys.readouterr().out.split())
    words = ["generate", "two people bow", "-o", str(out), "--generator", "choreographer"]
    assert main(words) == 0
    assert read_motion(out).interaction == "bow"


def test_the_help_names_the_default(shipped: Path, monkeypatch, tmp_path: Path, capsys) -> None:
    for folder, name in ((shipped, "diffusion"), (tmp_path / "none", "choreographer")):
        monkeypatch.setattr(model_folder, "SHIPPED", folder)
        with pytest.raises(SystemExit):
            main(["run", "--help"])
        assert f"default {name}" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("more", [(), ("--then", "they bow"), ("--people", "3")])
def test_a_model_of_the_repertoire_does_not_pretend_to_know_more(
    more: tuple[str, ...], shipped: Path, tmp_path: Path, capsys
) -> None:
    """It used to draw something for any sentence, and nothing said that it meant nothing."""
    words = ["generate", FOREIGN, "-o", str(tmp_path / "m.npz"), "--seconds", "1", "--raw", *more]
    assert main(words) == 1
    error = " ".join(capsys.readouterr().err.split())
    assert "not in the repertoire; the nearest is" in error
    assert "--nearest" in error
    assert not list(tmp_path.iterdir())
    assert main([*words, "--nearest", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert list(facts["drawn_as"]) == [FOREIGN]
    assert facts["understood"][0]["confidence"] < 0.5
    assert facts["text"].startswith(FOREIGN)


def test_the_nearest_interaction_is_drawn_in_words_that_the_model_knows(
    shipped: Path, tmp_path: Path
) -> None:
    from generator.runtime import DiffusionRequest, generate

    request = DiffusionRequest(seconds=1.0, nearest=True)
    motion, facts = generate(FOREIGN, request)
    told, understood = generate(facts["drawn_as"][FOREIGN], request)
    np.testing.assert_array_equal(motion.keypoints, told.keypoints)
    assert understood["understood"][0]["interaction"] == facts["understood"][0]["interaction"]


def test_a_later_part_outside_the_repertoire_is_refused_before_anything_is_drawn(
    shipped: Path, tmp_path: Path, capsys
) -> None:
    words = ["generate", "they bow", "--then", FOREIGN, "-o", str(tmp_path / "m.npz")]
    assert main(words) == 1
    assert "stock market" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_draws_where_torch_is_not_installed(packed: Path, tmp_path: Path) -> None:
    """The base install has neither torch nor onnx nor safetensors."""
    code = f"""
import sys
class NotInstalled:
    def find_spec(self, name, *rest):
        if name.partition(".")[0] in ("torch", "onnx", "safetensors"):
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, NotInstalled())
from pathlib import Path
from generator import model_folder
model_folder.SHIPPED = Path({str(packed)!r})
from bridge.cli import main
sys.exit(main(["generate", "they bow", "-o", {str(tmp_path / "m.npz")!r}, "--seconds", "1"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "by diffusion" in done.stdout
    assert read_motion(tmp_path / "m.npz").source == "tiny"


def test_a_damaged_shipped_model_is_one_line_and_exit_2(
    packed: Path, monkeypatch, tmp_path: Path, capsys
) -> None:
    folder = tmp_path / "shipped"
    shutil.copytree(packed, folder)
    monkeypatch.setattr(model_folder, "SHIPPED", folder)
    network = folder / json.loads((folder / HEADER).read_text())["network"]["file"]
    content = bytearray(network.read_bytes())
    content[len(content) // 2] ^= 1
    network.write_bytes(content)
    out = tmp_path / "m.npz"
    assert main(["generate", "they bow", "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert "SHA-256" in error
    assert "Traceback" not in error
    assert not out.exists()
