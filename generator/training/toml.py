"""TOML to frozen dataclasses and back: a key that nothing knows is an error, never ignored.

Torch-free.
"""

from __future__ import annotations

import tomllib
import types
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from robots.errors import DuetError, SpecError, nearest

T = TypeVar("T")

MAX_BYTES = 2**20
"""Largest configuration that is read."""


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises:
        SpecError: It cannot be read or is not TOML.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise SpecError(f"more than {MAX_BYTES} bytes", where=str(path))
        return tomllib.loads(data.decode())
    except FileNotFoundError as error:
        raise SpecError("there is no such file", where=str(path)) from error
    except OSError as error:
        raise SpecError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SpecError(f"this is not TOML: {error}", where=str(path)) from error


def build(kind: type[T], table: Any, *, where: str, derived: Collection[str] = ()) -> T:
    """Return a dataclass made of a table; what the table leaves out keeps its default.

    Args:
        kind: A dataclass; its fields may be numbers, strings, booleans, literals, tuples, other
            dataclasses, or one of these or nothing.
        table: The table.
        where: Name of the table, for errors.
        derived: Fields that follow from other settings and cannot be set.

    Raises:
        SpecError: A key is unknown or of another type, or a value is out of range.
    """
    if not isinstance(table, Mapping):
        raise SpecError(f"is {_name(table)}", where=where, allowed="a table")
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.name not in derived]  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        if key not in known:
            raise SpecError(
                f"unknown key '{key}'",
                where=where,
                allowed=", ".join(known),
                hint=nearest(key, known),
            )
        values[key] = _value(hints[key], value, f"{where}.{key}")
    try:
        return kind(**values)
    except DuetError as error:
        place = f"{where}.{error.where}" if error.where else where
        raise SpecError(error.what, where=place, allowed=error.allowed, hint=error.hint) from error
    except TypeError as error:
        missing = str(error).rpartition(":")[2].strip()
        raise SpecError(f"needs {missing}", where=where) from error


def _value(kind: Any, value: Any, where: str) -> Any:
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        inner = [part for part in parts if part is not type(None)]
        return _value(inner[0], value, where)
    if origin is Literal:
        if value not in parts or isinstance(value, bool):
            allowed = ", ".join(str(part) for part in parts)
            raise SpecError(
                f"{value!r}", where=where, allowed=allowed, hint=nearest(str(value), parts)
            )
        return value
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise SpecError(f"is {_name(value)}", where=where, allowed="a list")
        if parts[1:] != (Ellipsis,) and len(value) != len(parts):
            raise SpecError(f"{len(value)} entries", where=where, allowed=str(len(parts)))
        return tuple(_value(parts[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if is_dataclass(kind):
        return build(kind, value, where=where)  # type: ignore[arg-type]
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise SpecError(f"is {_name(value)}", where=where, allowed=_KINDS[kind])
    return value


_KINDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


def _name(value: Any) -> str:
    return _KINDS.get(type(value), f"a {type(value).__name__}")


def write_toml(tables: Mapping[str, Any]) -> str:
    """Return the TOML text of plain values, tables and lists of tables."""
    lines: list[str] = []
    _write_table(lines, "", tables)
    return "\n".join(lines).lstrip("\n") + "\n"


def _write_table(lines: list[str], path: str, table: Mapping[str, Any]) -> None:
    deeper = {}
    for key, value in table.items():
        nested = isinstance(value, Mapping) or (
            isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping)
        )
        if nested:
            deeper[key] = value
        else:
            lines.append(f"{key} = {_literal(value)}")
    for key, value in deeper.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            lines += ["", f"[{name}]"]
            _write_table(lines, name, value)
            continue
        for item in value:
            lines += ["", f"[[{name}]]"]
            _write_table(lines, name, item)


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_literal(item) for item in value) + "]"
    escaped = "".join(
        f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else "\\" + c if c in '"\\' else c
        for c in str(value)
    )
    return f'"{escaped}"'
