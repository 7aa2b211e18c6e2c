"""Configurations: TOML to dataclasses and back, and every file in configs/."""

from __future__ import annotations

import math
import string
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.training.config import (
    RunConfig,
    SourceConfig,
    TrainingConfig,
    changed_keys,
    load_config,
    parse,
)
from generator.training.toml import read_toml, write_toml
from robots.errors import SpecError

CONFIGS = Path(__file__).parents[2] / "configs"
MINIMAL = {"data": {"source": [{"kind": "choreographed"}]}}

TABLE_3 = {
    "canonical": ("model", {"representation": "canonical"}),
    "concat": ("model", {"conditioning": "concat"}),
    "unshared": ("model", {"share_weights": False}),
    "without-dm": ("objective", {"distance_map": 0.0}),
    "without-ro": ("objective", {"relative_orientation": 0.0}),
    "llama": ("text", {"encoder": "causal"}),
}


def test_what_a_file_leaves_out_has_the_values_of_the_paper() -> None:
    run = parse(MINIMAL)
    assert (run.model.width, run.model.layers, run.model.heads) == (1024, 8, 8)
    training = run.training
    assert (training.batch, training.epochs, training.warmup_epochs) == (64, 2000, 10)
    assert (training.learning_rate, training.weight_decay) == (1e-4, 2e-5)
    assert (training.betas, training.unconditional) == ((0.9, 0.999), 0.1)
    assert run.objective.last_regularised_step == 700


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"training": {"learning_rat": 1e-4}}, ("learning_rat", "did you mean 'learning_rate'")),
        ({"trainin": {}}, ("trainin", "did you mean 'training'")),
        ({"training": {"batch": 1.5}}, ("training.batch", "a whole number")),
        ({"training": {"batch": True}}, ("training.batch", "a whole number")),
        ({"training": {"precision": "bfloat"}}, ("precision", "did you mean 'bfloat16'")),
        ({"training": {"betas": [0.9]}}, ("betas", "2")),
        ({"training": {"betas": [0.9, 1.0]}}, ("betas", "below 1")),
        ({"training": {"learning_rate": math.nan}}, ("learning_rate",)),
        ({"training": {"weight_decay": math.inf}}, ("weight_decay",)),
        ({"training": 3}, ("training", "a table")),
        ({"model": {"text_width": 3}}, ("text_width",)),
        ({"model": {"features": 3}}, ("features",)),
        ({"model": {"heads": 3}}, ("3 heads",)),
        ({"objective": {"damping": 1.5}}, ("objective.damping", "0 to 1")),
        ({"objective": {"representation": "canonical"}}, ("representation",)),
        ({"text": {"encoder": "clip"}}, ("text", "a folder")),
        ({"text": {"encoder": "minilm", "lessons": 9}}, ("text", "layers that read")),
        ({"text": {"encoder": "initial"}}, ("text.encoder",)),
        ({"model": {"representation": "canonical"}, "training": {"freeze": "ends"}}, ("freeze",)),
        ({"model": {"representation": "canonical"}, "training": {"loss": "release"}}, ("loss",)),
        ({"data": {"source": [{"kind": "duets"}]}}, ("data.source[0]", "folder")),
        ({"data": {"source": [{"kind": "duets", "root": "x", "weight": 0}]}}, ("weight",)),
        ({"data": {"source": [{}]}}, ("source[0]", "kind")),
        ({"data": {}}, ("source", "[[data.source]]")),
        ({"checkpoint": {"steps": 0}}, ("checkpoint.steps",)),
    ],
)
def test_a_wrong_setting_is_named_with_what_is_allowed(tables: dict, words: tuple) -> None:
    with pytest.raises(SpecError) as caught:
        parse({**MINIMAL, **tables})
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("content", [b"a = ", b"\xff\xfe", b"[a]\n[a]\n", b"x" * (2**20 + 2)])
def test_a_file_that_is_not_toml_gives_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(SpecError, match=r"x\.toml"):
        load_config(path)
    with pytest.raises(SpecError, match="no such file"):
        load_config(tmp_path / "none.toml")


def test_the_saved_configuration_gives_the_same_run(tmp_path: Path) -> None:
    sources = (SourceConfig(kind="choreographed", count=3), SourceConfig(kind="duets", root="d"))
    run = parse({**MINIMAL, "name": 'a "quoted\\name"\n', "model": {"representation": "canonical"}})
    run = replace(run, data=replace(run.data, source=sources))
    path = tmp_path / "run.toml"
    path.write_text(run.toml(), "utf-8")
    assert load_config(path) == run


_TEXT = st.text(string.printable + "äß☃\x00\x7f", max_size=12)
_PLAIN = st.one_of(
    st.booleans(), st.integers(-(2**40), 2**40), st.floats(allow_nan=False), _TEXT,
    st.lists(st.integers(0, 9), max_size=3),
)  # fmt: skip
_KEYS = st.text(string.ascii_lowercase, min_size=1, max_size=5)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(_KEYS, st.one_of(_PLAIN, st.dictionaries(_KEYS, _PLAIN, max_size=3))))
def test_whatever_is_written_as_toml_is_read_back(tables: dict) -> None:
    import tomllib

    assert tomllib.loads(write_toml(tables)) == tables


def test_changes_that_matter_are_found_and_others_are_not() -> None:
    run = parse(MINIMAL)
    assert changed_keys(run, parse({**MINIMAL, "log": {"steps": 1}, "name": "other"})) == []
    other = parse({**MINIMAL, "training": {"seed": 1}, "objective": {"velocity": 1.0}})
    assert changed_keys(run, other) == ["objective.velocity", "training.seed"]


def test_length_and_warm_up_are_given_in_epochs_or_in_steps() -> None:
    run = parse(MINIMAL)
    assert (run.total_steps(3), run.warmup_steps(3)) == (6000, 30)
    run = replace(run, training=TrainingConfig(steps=7, warmup_steps=0))
    assert (run.total_steps(3), run.warmup_steps(3)) == (7, 0)
    run = replace(run, training=TrainingConfig(steps=7, cycles=3))
    assert (run.total_steps(3), run.cycle_steps(3)) == (21, 7)


def _as_shipped(name: str) -> RunConfig:
    return load_config(CONFIGS / f"{name}.toml")


@pytest.mark.parametrize("row", sorted(TABLE_3))
def test_a_row_of_table_3_differs_from_the_default_in_what_it_says(row: str) -> None:
    table, values = TABLE_3[row]
    default, variant = _as_shipped("intergen"), _as_shipped(f"table3/{row}")
    changed = {key for key in changed_keys(default, variant) if not key.endswith(".folder")}
    assert changed == {f"{table}.{key}" for key in values}
    for key, value in values.items():
        assert getattr(getattr(variant, table), key) == value


def test_the_rows_of_table_4_differ_in_the_threshold_alone() -> None:
    default = _as_shipped("intergen")
    names = sorted(path.stem for path in (CONFIGS / "table4").glob("*.toml"))
    assert names == ["none", *(f"t{i:02d}" for i in range(1, 11))]
    for i in range(1, 11):
        variant = _as_shipped(f"table4/t{i:02d}")
        assert variant.objective.last_regularised_step == pytest.approx(100 * i)
        assert changed_keys(default, variant) == ([] if i == 7 else ["objective.damping"])
    assert changed_keys(default, _as_shipped("table4/none")) == ["objective.regularisation"]


def test_no_shipped_configuration_holds_a_key_that_nothing_reads() -> None:
    paths = sorted(CONFIGS.rglob("*.toml"))
    assert len(paths) == 24
    for path in paths:
        assert parse(read_toml(path), where=path.name).name
