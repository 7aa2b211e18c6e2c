"""The model in the package, where a version has one, and the rules by which it gets there."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from generator import model_folder
from generator.model_folder import SHIPPED, checked_file, read_header, shipped_folder
from generator.runtime import DiffusionRequest, Portable, generate

ROOT = Path(__file__).parents[2]
LARGEST_MB = 40.0
"""Of the whole folder, in millions of bytes."""
ENDINGS = ("model.json", "MODEL_CARD.md", "network-0.onnx", "weights-0.safetensors")


def test_everything_of_a_shipped_model_gets_into_the_wheel(tmp_path):
    """Packed by this project's own rules: what .gitignore names would silently be left out."""
    for name in ("pyproject.toml", ".gitignore", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, tmp_path)
    place = SHIPPED.relative_to(ROOT)
    for package in ("robots", "sim", "bridge", str(place)):
        (tmp_path / package).mkdir(parents=True)
    for name in ENDINGS:
        (tmp_path / place / name).write_bytes(b"x")
    packed = {f.distribution_path for f in WheelBuilder(str(tmp_path)).recurse_included_files()}
    assert {str(place / name) for name in ENDINGS} <= packed


def test_a_model_that_has_no_header_is_none(tmp_path, monkeypatch):
    monkeypatch.setattr(model_folder, "SHIPPED", tmp_path)
    (tmp_path / "network-0.onnx").write_bytes(b"x")
    assert shipped_folder() is None
    (tmp_path / "model.json").write_text("{}")
    assert shipped_folder() == tmp_path


@pytest.fixture
def folder() -> Path:
    found = shipped_folder()
    if found is None:
        pytest.skip("no model ships with this version")
    return found


def test_the_shipped_model_is_whole_small_and_described(folder):
    size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
    assert size <= LARGEST_MB
    header = read_header(folder)
    named = {checked_file(folder, header, entry).name for entry in ("network", "weights")}
    assert {file.name for file in folder.iterdir()} == named | {"model.json", "MODEL_CARD.md"}
    card = (folder / "MODEL_CARD.md").read_text()
    for word in ("licence", header["provenance"]["licence"], "## Figures", "## Limits"):
        assert word in card
    assert Portable.load(folder).repertoire, "it would answer for sentences that it cannot know"


def test_the_shipped_model_draws_a_duet(folder):
    motion, facts = generate("two people shake hands", DiffusionRequest(seconds=2), seed=1)
    assert facts["weights"] == "shipped"
    assert facts["understood"][0]["interaction"] == "handshake"
    apart = motion.a.point("pelvis")[:, :2] - motion.b.point("pelvis")[:, :2]
    assert 0.2 < (apart**2).sum(axis=1).mean() ** 0.5 < 3
