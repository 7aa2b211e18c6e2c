"""Control tables against the maker's own, and the one place where ticks exist."""

from __future__ import annotations

import math
from pathlib import Path

import dynamixel_easy_sdk
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.servo.registers import (
    RPM,
    TickScale,
    control_table,
    hardware_error_names,
    model_name,
    model_names,
    velocity_counts,
)
from robots.errors import SpecError
from robots.servos import SERVO_MODELS

ORACLE = Path(dynamixel_easy_sdk.__file__).parent / "control_table"
XM430 = control_table("XM430-W350")
PROTOCOL_2 = [model for model in model_names() if control_table(model).protocol == 2]
NOT_REGISTERS = ("Indirect",)
"""The maker's files list where indirect blocks begin; ours describe them as blocks."""


def oracle_rows(model: str) -> dict[int, tuple[int, str]]:
    """Return (length, data name) by address from the maker's file for a model."""
    stem = model.lower().replace("-", "_")
    newer = ORACLE / f"{stem}_fw52.model"
    text = (newer if newer.exists() else ORACLE / f"{stem}.model").read_text()
    rows = {}
    for line in text.split("[control table]")[1].splitlines()[2:]:
        address, length, name = line.split("\t")
        if not name.startswith(NOT_REGISTERS):
            rows[int(address)] = (int(length), name.strip())
    return rows


def snake(name: str) -> str:
    """Return the maker's data name as we write it."""
    plain = {"Secondary(Shadow) ID": "shadow_id", "Secondary ID": "shadow_id"}.get(name, name)
    return plain.lower().replace(" ", "_")


@pytest.mark.parametrize("model", PROTOCOL_2)
def test_tables_agree_with_the_makers_files(model):
    ours = {r.address: (r.length, r.name) for r in control_table(model).registers.values()}
    theirs = oracle_rows(model)
    assert theirs, "the oracle is empty"
    for address, (length, name) in theirs.items():
        if name == "Acceleration Limit" and address not in ours:
            continue  # removed from the manual's newer tables of the X series
        assert ours[address] == (length, snake(name)), f"{model} at {address}"
    newer_than_oracle = {"startup_configuration", "backup_ready"}
    extra = {name for at, (_, name) in ours.items() if at not in theirs}
    assert extra <= newer_than_oracle


@pytest.mark.parametrize("model", PROTOCOL_2)
def test_model_numbers_agree_with_the_makers_list(model):
    listed = {}
    for line in (ORACLE / "dynamixel.model").read_text().splitlines()[1:]:
        number, file = line.split()
        listed[file.removesuffix(".model")] = int(number)
    assert control_table(model).number == listed[model.lower().replace("-", "_")]
    assert model_name(control_table(model).number) == model


@pytest.mark.parametrize("model", PROTOCOL_2)
def test_indirect_blocks_agree_with_the_makers_files(model):
    stem = model.lower().replace("-", "_")
    newer = ORACLE / f"{stem}_fw52.model"
    text = (newer if newer.exists() else ORACLE / f"{stem}.model").read_text()
    if not control_table(model).indirect:
        assert "Indirect" not in text
        return
    first = control_table(model).indirect[0]
    assert f"{first.address}\t2\tIndirect Address 1" in text
    assert f"{first.data}\t1\tIndirect Data 1" in text


@pytest.mark.parametrize("model", sorted(set(model_names()) & set(SERVO_MODELS)))
def test_speeds_agree_with_what_robots_are_described_by(model):
    assert control_table(model).no_load_speed == pytest.approx(SERVO_MODELS[model].no_load_speed)


@pytest.mark.parametrize("model", model_names())
def test_defaults_lie_within_their_ranges(model):
    table = control_table(model)
    for register in table.registers.values():
        if isinstance(register.default, int) and register.access == "rw":
            if register.values is not None:
                assert register.default in register.values, register.name
            if isinstance(register.min, int):
                assert register.default >= register.min, register.name
            if isinstance(register.max, int):
                assert register.default <= register.max, register.name
        for bound in (register.default, register.min, register.max):
            if isinstance(bound, str):
                assert bound.lstrip("-") in table, register.name


def test_every_servo_that_a_robot_may_name_has_a_table():
    assert set(SERVO_MODELS) <= set(model_names())


def test_an_unknown_model_names_the_nearest():
    with pytest.raises(SpecError, match="XM430-W350"):
        control_table("XM430-W360")


def test_registers_refuse_data_of_the_wrong_length():
    with pytest.raises(ValueError, match="4 bytes"):
        control_table("XM430-W350")["goal_position"].decode(b"\x00\x01")


@given(
    value=st.integers(-(2**31), 2**31 - 1),
)
def test_register_values_survive_their_bytes(value):
    register = control_table("XM430-W350")["goal_position"]
    assert register.decode(register.encode(value)) == value


@given(
    angle=st.floats(-3.0, 3.0),
    zero=st.integers(0, 4095),
    direction=st.sampled_from([-1, 1]),
    ratio=st.floats(0.1, 10),
    model=st.sampled_from(["XM430-W350", "PH54-200-S500", "AX-12A"]),
)
def test_ticks_are_within_half_a_tick_of_the_angle(angle, zero, direction, ratio, model):
    scale = TickScale.of(zero, direction, ratio, [control_table(model)])
    ticks = scale.to_ticks(angle)
    assert abs(scale.from_ticks(ticks)[0] - angle) <= scale.resolution[0] * (0.5 + 1e-9)
    assert scale.to_ticks(scale.from_ticks(ticks))[0] == ticks[0]


@given(count=st.integers(-3000, 3000))
def test_half_a_tick_rounds_to_even(count):
    scale = TickScale(
        np.array([0]), np.array([2.0]), np.array([1.0])
    )  # two ticks per rad: halves are exact
    assert scale.to_ticks((count + 0.5) / 2)[0] % 2 == 0


def test_direction_zero_and_ratio_act_as_documented():
    scale = TickScale.of([2048, 100], [-1, 1], [1.0, 2.0], [XM430, XM430])
    assert scale.to_ticks([0.5, 0.5]).tolist() == [1722, 100 + round(4096 / (2 * math.pi))]
    assert scale.velocity([10, 10])[0] == pytest.approx(-2.29 * RPM)
    assert scale.velocity([10, 10])[1] == pytest.approx(2.29 * RPM / 2)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_tick_comes_from_a_number_that_is_not_finite(bad):
    with pytest.raises(ValueError, match="finite"):
        TickScale.of([0], [1], [1], [XM430]).to_ticks([bad])


def test_a_speed_ceiling_is_never_the_zero_that_means_unlimited():
    assert velocity_counts(1e-6, XM430) == 1
    assert velocity_counts(46 * RPM, XM430) == 201
    assert velocity_counts(20 * RPM, control_table("PM54-060-S250")) == 2000


def test_hardware_errors_have_names():
    assert hardware_error_names(0b100100) == ("overheating", "overload")
