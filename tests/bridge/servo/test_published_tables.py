"""Tables that the SDK has no file for, and factory values: as the maker's manual prints them."""

from __future__ import annotations

import pytest

from bridge.servo.registers import control_table

# Address, bytes, initial value ("-" where the manual has none), as in the e-manual's tables.
AX_12A = """
0 2 12   | 2 1 -    | 3 1 1    | 4 1 1   | 5 1 250  | 6 2 0    | 8 2 1023 | 11 1 70  | 12 1 60
13 1 140 | 14 2 1023 | 16 1 2  | 17 1 36 | 18 1 36  | 24 1 0   | 25 1 0   | 26 1 1   | 27 1 1
28 1 32  | 29 1 32  | 30 2 -   | 32 2 -  | 34 2 1023 | 36 2 -  | 38 2 -   | 40 2 -   | 42 1 -
43 1 -   | 44 1 0   | 46 1 0   | 47 1 0  | 48 2 32
"""
AX_18A = (
    AX_12A.replace("0 2 12 ", "0 2 18 ")
    .replace("11 1 70", "11 1 75")
    .replace("14 2 1023", "14 2 983")
    .replace("34 2 1023", "34 2 983")
)
MX_28 = """
0 2 29   | 2 1 -    | 3 1 1    | 4 1 34  | 5 1 250  | 6 2 0    | 8 2 4095 | 11 1 80  | 12 1 60
13 1 160 | 14 2 1023 | 16 1 2  | 17 1 36 | 18 1 36  | 20 2 0   | 22 1 1   | 24 1 0   | 25 1 0
26 1 0   | 27 1 0   | 28 1 32  | 30 2 -  | 32 2 -   | 34 2 1023 | 36 2 -  | 38 2 -   | 40 2 -
42 1 -   | 43 1 -   | 44 1 0   | 46 1 0  | 47 1 0   | 48 2 0   | 73 1 0
"""
MX_64 = (
    MX_28.replace("0 2 29 ", "0 2 310 ").replace("13 1 160", "13 1 240")
    + "| 50 2 0 | 68 2 - | 70 1 0 | 71 2 0"
)
MX_106 = MX_64.replace("0 2 310", "0 2 320").replace("13 1 240", "13 1 160") + "| 10 1 0"
MX_12W = (
    MX_28.replace("0 2 29 ", "0 2 104 ")
    .replace("4 1 34", "4 1 1")
    .replace("26 1 0", "26 1 8")
    .replace("28 1 32", "28 1 8")
    .replace("48 2 0", "48 2 32")
    + "| 50 2 -"
)
XL_320 = """
0 2 350  | 2 1 -    | 3 1 1    | 4 1 3   | 5 1 250  | 6 2 0    | 8 2 1023 | 11 1 2   | 12 1 65
13 1 60  | 14 1 90  | 15 2 1023 | 17 1 2 | 18 1 3   | 24 1 0   | 25 1 0   | 27 1 0   | 28 1 0
29 1 32  | 30 2 -   | 32 2 -   | 35 2 -  | 37 2 -   | 39 2 -   | 41 2 -   | 45 1 -   | 46 1 -
47 1 0   | 49 1 0   | 50 1 0   | 51 2 32
"""
WHOLE = {
    "AX-12A": AX_12A,
    "AX-18A": AX_18A,
    "MX-12W": MX_12W,
    "MX-28(1.0)": MX_28,
    "MX-64(1.0)": MX_64,
    "MX-106(1.0)": MX_106,
    "XL320": XL_320,
}

# Of each P servo: limits of current, acceleration, velocity; largest goal and its limit; gains I
# and P of the velocity and P of the position; Shutdown.
P_SERIES = {
    "PH42-020-S300": (4500, 4_306_173, 2920, 303_454, 303_750, 502, 1332, 879, 58),
    "PH54-100-S500": (15_900, 4_255_632, 2920, 501_433, 501_923, 1290, 3593, 502, 58),
    "PH54-200-S500": (22_740, 3_992_644, 2900, 501_433, 501_923, 2209, 6153, 314, 52),
    "PM42-010-S260": (1461, 4_346_756, 2600, 262_931, 263_187, 6740, 2145, 1061, 58),
    "PM54-040-S250": (4470, 4_414_976, 2840, 251_173, 251_417, 408, 1137, 502, 58),
    "PM54-060-S250": (7980, 4_457_932, 2830, 251_173, 251_417, 813, 2265, 502, 58),
}


def rows(text: str) -> dict[int, tuple[int, str]]:
    """Return (bytes, initial value) by address."""
    fields = (row.split() for row in text.replace("\n", "|").split("|") if row.strip())
    return {int(address): (int(length), value) for address, length, value in fields}


@pytest.mark.parametrize("model", WHOLE)
def test_a_table_is_the_published_one_address_by_address(model):
    table, published = control_table(model), rows(WHOLE[model])
    ours = {register.address: register.length for register in table.registers.values()}
    assert ours == {address: length for address, (length, _) in published.items()}
    assert str(table.number) == published[0][1]
    for register in table.registers.values():
        value = published[register.address][1]
        if value == "-" or register.name == "model_number":
            continue
        default = register.default
        if isinstance(default, str):
            default = table[default].default
        assert str(default) == value, register.name


@pytest.mark.parametrize("model", P_SERIES)
def test_a_p_servo_has_the_published_limits_and_gains(model):
    table = control_table(model)
    current, acceleration, velocity, limit, turn, *gains, shutdown = P_SERIES[model]
    assert table["current_limit"].default == table["current_limit"].max == current
    assert table["acceleration_limit"].max == acceleration
    assert table["velocity_limit"].default == table["velocity_limit"].max == velocity
    assert table["max_position_limit"].default == limit
    assert (table["min_position_limit"].min, table["max_position_limit"].max) == (-turn, turn)
    assert table.units.ticks_per_turn == pytest.approx(2 * turn, abs=1.5)
    names = ("velocity_i_gain", "velocity_p_gain", "position_p_gain")
    assert [table[name].default for name in names] == gains
    assert table["shutdown"].default == shutdown


@pytest.mark.parametrize(
    ("model", "unit", "published"),
    [
        ("PH54-200-S500", "position", 6.259e-6),  # rad
        ("PM54-060-S250", "velocity", 0.0010471976),  # rad/s
        ("XL320", "velocity", 0.0116228475),
        ("XM430-W350", "velocity", 0.0239810),
        ("AX-12A", "position", 0.0051181),  # 0.29 degrees
    ],
)
def test_units_are_the_published_ones(model, unit, published):
    assert getattr(control_table(model).units, unit) == pytest.approx(published, rel=1e-3)
