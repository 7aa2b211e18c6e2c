"""Robots by name or folder: reads ``robot.toml`` into a :class:`~robots.spec.RobotSpec`.

A robot folder may come from a stranger. Its TOML is data only; every key must be known, every path
stays below the folder, and the MJCF is scanned before MuJoCo sees it (:mod:`robots.mjcf`).
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Any, cast

from robots.errors import SpecError, nearest
from robots.mjcf import inside, scan_mjcf
from robots.servos import servo_model
from robots.spec import NAME, BusSpec, JointSpec, Landmark, RobotSpec, ServoSpec

SCHEMA = 1
ROBOT_FILE = "robot.toml"
MAX_TOML_BYTES = 2**20
_DEGREES = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*deg\s*")
_MISSING = object()


def robot_names() -> tuple[str, ...]:
    """Return the names of the built-in robots: every folder here that has a ``robot.toml``."""
    here = Path(__file__).parent
    return tuple(sorted(path.parent.name for path in here.glob(f"*/{ROBOT_FILE}")))


def load_robot(name_or_folder: str | Path) -> RobotSpec:
    """Return a built-in robot by name, or the robot of a folder.

    Raises:
        SpecError: There is no such robot, or its files are wrong.
    """
    text = str(name_or_folder)
    if isinstance(name_or_folder, str) and text in robot_names():
        return read_robot(Path(__file__).parent / text)
    folder = Path(name_or_folder)
    if folder.name == ROBOT_FILE:
        folder = folder.parent
    if (folder / ROBOT_FILE).is_file():
        return read_robot(folder)
    raise SpecError(
        f"there is no robot '{text}'",
        allowed=f"{', '.join(robot_names())}, or a folder with a {ROBOT_FILE}",
        hint=nearest(text, robot_names()),
    )


def read_robot(folder: Path) -> RobotSpec:
    """Read and check the robot in ``folder``.

    Raises:
        SpecError: Whatever is wrong with ``robot.toml`` or the MJCF.
    """
    path = folder / ROBOT_FILE
    top = _Table(_parse_toml(path), str(path))
    schema = top.integer("schema")
    if schema != SCHEMA:
        raise SpecError(f"schema {schema}", where=str(path), allowed=str(SCHEMA))
    name = top.text("name")
    title = top.text("title", "")
    model = inside(folder, top.text("model", "robot.xml"), where=str(path))
    base = top.text("base", "free")
    cycle_ms = top.number("cycle_ms", 10.0)
    defaults = top.table("defaults", {})
    buses = {key: _bus(key, table) for key, table in top.tables("bus")}
    joints = tuple(_joint(key, table, defaults) for key, table in top.tables("joint"))
    landmarks = {key: _landmark(key, value, path) for key, value in top.mapping("landmark")}
    _check_defaults(defaults)
    top.done()
    scan_mjcf(model, folder)
    return RobotSpec(
        name, folder, model, cast(Any, base), joints, buses, landmarks, cycle_ms, title
    )


def _parse_toml(path: Path) -> dict[str, Any]:
    try:
        data = path.read_bytes()
        if len(data) > MAX_TOML_BYTES:
            raise SpecError(f"{len(data)} bytes", where=str(path), allowed="at most 1 MiB")
        return tomllib.loads(data.decode("utf-8"))
    except OSError as error:
        reason = error.strerror or str(error)
        raise SpecError(f"cannot be read: {reason}", where=str(path)) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SpecError(f"is not valid TOML: {error}", where=str(path)) from error


_SERVO_KEYS = ("servo", "bus", "direction", "zero", "ratio", "mode", "p", "i", "d")
_JOINT_KEYS = ("max_velocity", "max_effort")


def _check_defaults(defaults: _Table) -> None:
    for key in (*_SERVO_KEYS, *_JOINT_KEYS):
        defaults.take(key, None)
    defaults.done()


def _bus(name: str, table: _Table) -> BusSpec:
    bus = BusSpec(name, table.text("port"), table.integer("baud"), table.number("protocol", 2.0))
    table.done()
    return bus


def _joint(name: str, table: _Table, defaults: _Table) -> JointSpec:
    table.fall_back_on(defaults, (*_SERVO_KEYS, *_JOINT_KEYS))
    model = table.text("servo")
    hardware = servo_model(model, where=table.where)
    servo = ServoSpec(
        id=table.integer("id"),
        model=model,
        bus=table.text("bus", "main"),
        direction=table.integer("direction", 1),
        zero=table.integer("zero", hardware.first + hardware.ticks // 2),
        ratio=table.number("ratio", 1.0),
        mode=table.text("mode", "position"),
        p=table.optional_integer("p"),
        i=table.optional_integer("i"),
        d=table.optional_integer("d"),
    )
    limit = table.take("limit")
    if not (isinstance(limit, list) and len(limit) == 2):
        raise SpecError("limit is not a pair", where=table.where, allowed='["-90deg", "90deg"]')
    lower, upper = (_angle(value, f"{table.where}.limit") for value in limit)
    joint = JointSpec(
        name=name,
        lower=lower,
        upper=upper,
        rest=_angle(table.take("rest", 0.0), f"{table.where}.rest"),
        max_velocity=table.number("max_velocity", hardware.no_load_speed / servo.ratio),
        max_effort=table.number("max_effort", hardware.stall_torque * servo.ratio),
        servo=servo,
    )
    table.done()
    return joint


def _landmark(name: str, value: object, path: Path) -> Landmark:
    where = f"{path}: landmark.{name}"
    if isinstance(value, str):
        return Landmark(name, value)
    if not isinstance(value, dict):
        raise SpecError("is neither a body name nor a table", where=where)
    table = _Table(value, where)
    pos = table.take("pos", [0.0, 0.0, 0.0])
    if not (isinstance(pos, list) and len(pos) == 3 and all(_is_number(x) for x in pos)):
        raise SpecError("pos is not three numbers", where=where, allowed="[x, y, z] in m")
    landmark = Landmark(
        name,
        table.text("body"),
        (float(pos[0]), float(pos[1]), float(pos[2])),
        table.number("radius", 0.0),
    )
    table.done()
    return landmark


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _angle(value: object, where: str) -> float:
    """Return an angle in rad from a number (rad) or a string like ``"54deg"``."""
    if _is_number(value):
        angle = float(cast(float, value))
        if math.isfinite(angle):
            return angle
    elif isinstance(value, str) and (match := _DEGREES.fullmatch(value)):
        return math.radians(float(match[1]))
    raise SpecError(
        f"{value!r} is not an angle", where=where, allowed='rad as a number, or "54deg"'
    )


class _Table:
    """A TOML table that knows where it stands and which of its keys nobody asked for."""

    def __init__(self, data: dict[str, Any], where: str) -> None:
        self.data = data
        self.where = where
        self.asked: set[str] = set()

    def take(self, key: str, default: Any = _MISSING) -> Any:
        self.asked.add(key)
        if key in self.data:
            return self.data[key]
        if default is _MISSING:
            raise SpecError(f"key '{key}' is missing", where=self.where, hint=self._near(key))
        return default

    def _near(self, key: str) -> str:
        match = difflib.get_close_matches(key, [k for k in self.data if k not in self.asked], n=1)
        return f"is '{match[0]}' meant to be it?" if match else ""

    def text(self, key: str, default: Any = _MISSING) -> str:
        return self._typed(key, default, lambda v: isinstance(v, str), "text")

    def integer(self, key: str, default: Any = _MISSING) -> int:
        return self._typed(
            key, default, lambda v: isinstance(v, int) and not isinstance(v, bool), "a whole number"
        )

    def optional_integer(self, key: str) -> int | None:
        return None if self.take(key, None) is None else self.integer(key)

    def number(self, key: str, default: Any = _MISSING) -> float:
        return float(self._typed(key, default, _is_number, "a number"))

    def _typed(self, key: str, default: Any, accept: Any, kind: str) -> Any:
        value = self.take(key, default)
        if not accept(value):
            raise SpecError(f"{key} = {value!r}", where=self.where, allowed=kind)
        return value

    def mapping(self, key: str) -> list[tuple[str, Any]]:
        value = self.take(key, {})
        if not isinstance(value, dict):
            raise SpecError(f"'{key}' is not a table", where=self.where)
        for name in value:
            if not NAME.fullmatch(name):
                raise SpecError(
                    f"{key} name '{name}' is not allowed",
                    where=self.where,
                    allowed="letters a-z, 0-9 and _",
                )
        return list(value.items())

    def table(self, key: str, default: Any = _MISSING) -> _Table:
        value = self.take(key, default)
        if not isinstance(value, dict):
            raise SpecError(f"'{key}' is not a table", where=self.where)
        return _Table(value, f"{self.where}: {key}")

    def tables(self, key: str) -> list[tuple[str, _Table]]:
        out = []
        for name, value in self.mapping(key):
            if not isinstance(value, dict):
                raise SpecError(f"'{key}.{name}' is not a table", where=self.where)
            out.append((name, _Table(value, f"{self.where}: {key}.{name}")))
        return out

    def fall_back_on(self, defaults: _Table, keys: tuple[str, ...]) -> None:
        shared = {k: v for k, v in defaults.data.items() if k in keys}
        self.data = {**shared, **self.data}

    def done(self) -> None:
        """Refuse keys that were not asked for."""
        for key in self.data:
            if key not in self.asked:
                raise SpecError(
                    f"unknown key '{key}'",
                    where=self.where,
                    allowed=", ".join(sorted(self.asked)),
                    hint=nearest(key, self.asked),
                )
