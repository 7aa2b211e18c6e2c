"""MJCF files from strangers: looked at before MuJoCo opens them, and compiled without surprises.

**The problem.** MuJoCo follows ``<include>`` and asset files anywhere on disk, by absolute path and
by ``..``, and loads plug-ins (native code) that a file names. A robot folder is data somebody sent.
So the XML is first parsed with the standard library: a document type (entities can read files and
grow without bound), plug-ins and extensions are refused, and every file that is named must lie
inside the robot's folder, followed recursively.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

from robots.errors import SpecError

if TYPE_CHECKING:
    import mujoco

    from robots.spec import RobotSpec

MAX_XML_BYTES = 8 * 2**20
_REFUSED = {"plugin", "extension"}
_MODELS = {"include", "model"}
_STAY = "keep all of a robot's files in its folder"
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def inside(folder: Path, name: str, *, where: str) -> Path:
    """Return the file ``name`` below ``folder``, following links.

    Raises:
        SpecError: It lies elsewhere, or is not a file.
    """
    return _resolve(name, [folder], folder, where=where)[0]


def scan_mjcf(path: Path, folder: Path) -> None:
    """Refuse an MJCF that reaches outside ``folder`` or loads code.

    Raises:
        SpecError: Names the file and the element.
    """
    files: dict[Path, ET.Element] = {}
    _follow(path, path.parent, folder, files)
    bases = {file.parent for file in files}
    dirs = {""}
    for root in files.values():
        for compiler in root.iter("compiler"):
            dirs.update(compiler.get(key, "") for key in _FOLDERS)
    places = [base / directory for base in bases for directory in dirs]
    for file, root in files.items():
        for element in root.iter():
            for key, name in element.attrib.items():
                if key.startswith("file") and element.tag not in _MODELS:
                    _resolve(name, places, folder, where=f"{file}: <{element.tag}>")


def _follow(path: Path, main: Path, folder: Path, files: dict[Path, ET.Element]) -> None:
    """Parse ``path`` and every model it includes into ``files``."""
    if path in files:
        return
    root = files[path] = _parse(path)
    for element in root.iter():
        where = f"{path}: <{element.tag}>"
        if element.tag in _REFUSED:
            raise SpecError("plug-ins are not loaded from robot folders", where=where)
        if element.tag in _MODELS and (name := element.get("file")) is not None:
            for found in _resolve(name, [path.parent, main], folder, where=where):
                _follow(found, main, folder, files)


def _resolve(name: str, places: list[Path], folder: Path, *, where: str) -> list[Path]:
    """Return the files MuJoCo may mean by ``name``; wherever it looks must be in ``folder``."""
    root = folder.resolve()
    found = []
    for place in places:
        try:
            path = (place / name).resolve()
            exists = path.is_file()
        except (OSError, ValueError, RuntimeError) as error:
            raise SpecError(f"'{name}' is not a usable file name", where=where) from error
        if not path.is_relative_to(root):
            raise SpecError(f"'{name}' leaves the robot's folder", where=where, hint=_STAY)
        if exists:
            found.append(path)
    if not found:
        raise SpecError(f"there is no file '{name}'", where=where)
    return found


def _parse(path: Path) -> ET.Element:
    """Parse XML, refusing document types before any entity could be expanded."""
    try:
        data = path.read_bytes()
    except OSError as error:
        reason = error.strerror or str(error)
        raise SpecError(f"cannot be read: {reason}", where=str(path)) from error
    if len(data) > MAX_XML_BYTES:
        raise SpecError(f"{len(data)} bytes of XML", where=str(path), allowed="at most 8 MiB")

    def refuse(*_: object) -> None:
        raise SpecError("document types are not allowed", where=str(path))

    try:
        guard = expat.ParserCreate()
        guard.StartDoctypeDeclHandler = refuse
        guard.Parse(data, True)
        root = ET.fromstring(data)  # noqa: S314 - no document type, so no entities
    except (expat.ExpatError, ET.ParseError, ValueError) as error:
        raise SpecError(f"is not valid XML: {error}", where=str(path)) from error
    if root.tag not in ("mujoco", "mujocoinclude"):
        raise SpecError(f"starts with <{root.tag}>", where=str(path), allowed="<mujoco>")
    return root


def load_mjspec(robot: RobotSpec) -> mujoco.MjSpec:
    """Return the robot's MJCF as an editable MuJoCo spec.

    Raises:
        SpecError: MuJoCo does not accept it.
    """
    import mujoco

    scan_mjcf(robot.model, robot.folder)
    try:
        return mujoco.MjSpec.from_file(str(robot.model))
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip() or repr(error)
        raise SpecError(f"MuJoCo refuses it: {reason}", where=str(robot.model)) from error
