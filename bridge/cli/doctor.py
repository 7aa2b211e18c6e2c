"""``pasdedeux doctor``: check this machine."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from bridge.cli.console import Console

_MARKS = {"ok": "[green]ok[/]", "note": "[yellow]note[/]", "fail": "[red]fail[/]"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the machine is what it is."""


def execute(args: argparse.Namespace, console: Console) -> int:
    """Print the findings; 0 if nothing fails, else 2."""
    from bridge.doctor import examine

    findings = examine()
    failed = any(finding.status == "fail" for finding in findings)
    console.table(
        "this machine",
        ["what", "state", "found", "do"],
        [[f.name, _MARKS[f.status], f.detail, f.hint] for f in findings],
    )
    console.result({"passed": not failed, "findings": [asdict(f) for f in findings]})
    return 2 if failed else 0
