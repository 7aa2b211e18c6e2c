"""Is this machine fit? Packages, offscreen OpenGL, pseudo-terminals, adapters and servo buses."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from bridge.setup.budget import budgets
from bridge.setup.scan import Scan, mismatches
from robots.errors import DuetError
from robots.spec import RobotSpec

Status = Literal["ok", "note", "fail"]

BUSY = 0.8
"""Share of a wire's time beyond which hardly any is left for adapters and the computer."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    name: str
    """What was looked at."""
    status: Status
    """``ok``; ``note``: works, but know this; ``fail``: something will not work."""
    detail: str
    """What was found."""
    hint: str = ""
    """What to do about it."""


def examine_buses(robot: RobotSpec, rate: float | None = None) -> list[Finding]:
    """Say what the wires of a robot's buses allow, against a rate in Hz (default: its own cycle).

    Raises:
        SpecError: There is no control table for a servo's model.
    """
    wanted = 1e3 / robot.cycle_ms if rate is None else rate
    findings: list[Finding] = []
    for budget in budgets(robot):
        detail = (
            f"{budget.servos} servos at {budget.baud} bit/s: at most {budget.plain:.0f} Hz"
            + (f", {budget.fast:.0f} Hz with fast reads" if budget.fast is not None else "")
            + f" ({budget.factory:.0f} Hz with the return delay of new servos, which play clears)"
            + f"; {wanted:.0f} Hz wanted"
        )
        name = f"{robot.name}: bus {budget.bus}"
        if budget.best < wanted:
            hint = "raise the servos' bit rate (pasdedeux setup-id), or use two buses"
            findings.append(Finding(name, "fail", detail, hint))
        elif budget.best < wanted / BUSY:
            hint = "little room is left for a slow adapter: raise the servos' bit rate"
            findings.append(Finding(name, "note", detail, hint))
        else:
            findings.append(Finding(name, "ok", detail))
    return findings


def examine_servos(robot: RobotSpec, bus: str, found: Scan) -> list[Finding]:
    """Say what a scan found on a bus: who is missing or wrong, and what slows it down."""
    wrong = mismatches(found, robot, bus)
    name = f"{found.port}"
    hint = "" if not wrong else "correct the ids (pasdedeux setup-id) or robot.toml"
    findings = [Finding(name, "fail", line, hint) for line in wrong]
    if not wrong:
        findings.append(Finding(name, "ok", f"all {len(found.servos)} servos of {robot.name}"))
    for servo in found.servos:
        for note in servo.notes:
            status: Status = "fail" if servo.clash or "error" in note else "note"
            findings.append(Finding(f"servo {servo.id}", status, note))
    if found.echo:
        findings.append(Finding(name, "fail", "hears what it sends", "use a half-duplex adapter"))
    return findings


def examine() -> list[Finding]:
    """Look at everything and return the findings; takes about a second."""
    looks: tuple[Callable[[], Iterator[Finding]], ...] = (
        _python,
        _packages,
        _mujoco,
        _encoder,
        _opengl,
        _virtual_bus,
        _serial_ports,
    )
    return [finding for look in looks for finding in look()]


def _python() -> Iterator[Finding]:
    text = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    status: Status = "ok" if sys.version_info >= (3, 11) else "fail"
    yield Finding("Python", status, text, "" if status == "ok" else "install 3.11 or newer")
    yield Finding("processors", "ok", str(os.cpu_count()))


def _packages() -> Iterator[Finding]:
    from packaging.requirements import Requirement

    try:
        needed = [Requirement(text) for text in requires("pasdedeux") or []]
    except PackageNotFoundError:
        yield Finding("pasdedeux", "fail", "not installed", "pip install -e .")
        return
    for requirement in needed:
        if requirement.marker and "extra" in str(requirement.marker):
            continue
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            hint = f"pip install '{requirement.name}{requirement.specifier}'"
            yield Finding(requirement.name, "fail", "missing", hint)
            continue
        fits = requirement.specifier.contains(found, prereleases=True)
        hint = "" if fits else f"pip install '{requirement.name}{requirement.specifier}'"
        yield Finding(requirement.name, "ok" if fits else "fail", found, hint)
    for name, extra in (("viser", "view"), ("torch", "train")):
        try:
            yield Finding(name, "ok", version(name))
        except PackageNotFoundError:
            yield Finding(
                name, "note", "not installed (optional)", f"pip install 'pasdedeux[{extra}]'"
            )


def _mujoco() -> Iterator[Finding]:
    """MuJoCo 4 comes in parts that overwrite MuJoCo 3 in place, and stay behind when it goes."""
    found: dict[str, str] = {}
    for name in ("mujoco", "mujoco-core", "mujoco-studio"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    yield from mujoco_mixture(found)


def mujoco_mixture(found: Mapping[str, str]) -> Iterator[Finding]:
    """Judge the versions of MuJoCo's packages, by name; those that are installed."""
    again = "pip uninstall -y mujoco mujoco-core mujoco-studio && pip install -e ."
    core = found.get("mujoco-core")
    if "4.0.0" in found.values():
        detail = "4.0.0: its sparse factorisation is wrong, as its maker says"
        yield Finding("MuJoCo's parts", "fail", detail, again)
    elif core is None:
        yield Finding("MuJoCo's parts", "ok", "one package")
    elif len(set(found.values())) > 1:
        parts = ", ".join(f"{name} {number}" for name, number in found.items())
        yield Finding("MuJoCo's parts", "fail", f"of several versions: {parts}", again)
    else:
        yield Finding("MuJoCo's parts", "ok", f"all of version {core}")


def _encoder() -> Iterator[Finding]:
    from generator.text import MiniLmEncoder

    try:
        MiniLmEncoder().encode(["two people shake hands"])
    except DuetError as error:
        yield Finding("sentence encoder", "fail", str(error))
    else:
        yield Finding("sentence encoder", "ok", "MiniLM answers")


def _opengl() -> Iterator[Finding]:
    import mujoco

    from sim.camera import still
    from sim.render import Painter

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    )
    backend = os.environ.get("MUJOCO_GL", "") or "MuJoCo's default"
    try:
        with Painter(model, width=32, height=32) as painter:
            painter.paint(model.qpos0, still(), 0)
    except DuetError as error:
        yield Finding(
            "offscreen OpenGL", "note", f"none: videos are left out ({error.what})", error.hint
        )
    else:
        yield Finding("offscreen OpenGL", "ok", backend)


def _virtual_bus() -> Iterator[Finding]:
    try:
        main, port = os.openpty()
    except (AttributeError, OSError) as error:
        yield Finding("pseudo-terminals", "fail", f"none ({error}): no virtual servo bus")
        return
    os.close(main)
    os.close(port)
    yield Finding("pseudo-terminals", "ok", "the virtual servo bus can be opened")


def _serial_ports() -> Iterator[Finding]:
    from serial.tools import list_ports

    ports = [port for port in list_ports.comports() if port.vid is not None]
    if not ports:
        yield Finding("serial adapters", "note", "none plugged in; the virtual bus needs none")
    for port in ports:
        yield _permission(port.device, port.description)
        yield from _latency(port.device)
    for name in ("brltty", "ModemManager"):
        if ports and _runs(name):
            yield Finding(
                name,
                "note",
                "runs and may grab serial adapters",
                f"if servos do not answer: systemctl stop {name}",
            )


def _permission(device: str, description: str) -> Finding:
    if os.access(device, os.R_OK | os.W_OK):
        return Finding(device, "ok", description)
    return Finding(
        device,
        "fail",
        f"{description}: no permission",
        "sudo usermod -aG dialout $USER, then log in again",
    )


def _latency(device: str) -> Iterator[Finding]:
    """The USB adapter's latency timer: 16 ms by default, which caps any servo bus at 60 Hz."""
    timer = Path("/sys/bus/usb-serial/devices") / Path(device).name / "latency_timer"
    try:
        milliseconds = int(timer.read_text())
    except (OSError, ValueError):
        return
    if milliseconds > 1:
        yield Finding(
            f"{device} latency",
            "note",
            f"{milliseconds} ms: reads are capped near {1000 // (milliseconds + 1)} Hz",
            f"echo 1 | sudo tee {timer}",
        )
    else:
        yield Finding(f"{device} latency", "ok", f"{milliseconds} ms")


def _runs(program: str) -> bool:
    for comm in Path("/proc").glob("[0-9]*/comm"):
        try:
            if comm.read_text().strip() == program:
                return True
        except OSError:
            continue
    return False
