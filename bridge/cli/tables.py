"""Tables of the command line: reports and summaries as a person reads them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.console import Console

if TYPE_CHECKING:
    from sim.report import Report

_TITLES = {"simulated": "what the physics did", "reference": "what was asked of it"}
_MARKS = {"ok": "[green]ok[/]", "FAIL": "[red]FAIL[/]", "": ""}


def show_report(console: Console, report: Report) -> None:
    """Print every metric, its threshold and the verdict."""
    together: dict[str, dict[str, dict[str, tuple[str, str, str]]]] = {}
    for name, of, person, *found in report.rows():
        together.setdefault(of, {}).setdefault(name, {})[person] = (found[0], found[1], found[2])
    for of, metrics in together.items():
        rows = []
        for name, people in metrics.items():
            first = people.get("a") or people["both"]
            second = people.get("b", ("", "", ""))
            mark = "FAIL" if "FAIL" in (first[2], second[2]) else first[2]
            rows.append([name, first[0], second[0], first[1], _MARKS[mark]])
        console.table(_TITLES[of], ["", "a", "b", "allowed", ""], rows)
    for line in report.failures:
        console.show(f"failed: {line}")
    console.show(f"score {report.score:.0f} of 100: {'plausible' if report.passed else 'refused'}")


def show_summary(console: Console, summary: dict[str, Any]) -> None:
    """Print a run's summary, one line per stage."""
    rows = [[stage, *line] for stage, line in _lines(summary)]
    title = summary["motion"]["text"] or Path(summary["settings"]["source"]).stem
    console.table(title, ["", "how it went", "s"], rows)


def _lines(summary: dict[str, Any]) -> list[tuple[str, tuple[str, str]]]:
    times = summary["stage_seconds"]
    motion, report, tracking = summary["motion"], summary["report"], summary["tracking"]
    retargeting, performance = summary["retargeting"], summary["performance"]
    what = motion["interaction"] or "from a file"
    if "confidence" in motion:
        what += f", {motion['confidence']:.0%} sure"
    off = tracking["mpjpe_global_mm"]
    lines = [
        (
            "generated",
            f"{what}; {motion['seconds']:.1f} s, {len(motion['contacts'])} touches labelled",
        ),
        (
            "tracked",
            f"{off['a']:.0f} / {off['b']:.0f} mm off (a / b), {_fallen(tracking['fell'])}, helped"
            f" with {tracking['assist_mean_percent']:.0f} % of body weight",
        ),
        (
            "plausible",
            f"score {report['score']:.0f} of 100, {'passed' if report['passed'] else 'refused'}",
        ),
        (
            "retargeted",
            f"{' and '.join(retargeting['robots'])}; contact recall"
            f" {retargeting['contact_recall']:.0%}, gaps off by"
            f" {retargeting['contact_gap_error_mm']:.1f} mm, time x {retargeting['slowed_by']:.2f}",
        ),
    ]
    if performance is None:
        lines.append(("performed", "no: the gate refused it"))
    else:
        rms, lag = performance["rms_deg"], performance["lag_ms"]
        lines.append(
            (
                "performed",
                f"servos {rms['a']:.1f}° / {rms['b']:.1f}° off, {lag['a']:.0f} / {lag['b']:.0f} ms"
                f" behind; {performance['ticks']} ticks, {performance['late_ticks']} late,"
                f" {performance['dropped_ticks']} left out",
            )
        )
    lines.append(("pictures", summary["pictures"]))
    stages = ("generate", "track", "score", "retarget", "play", "film")
    return [
        (name, (text, f"{times[stage]:.1f}" if stage in times else ""))
        for (name, text), stage in zip(lines, stages, strict=True)
    ]


def _fallen(fell: dict[str, bool]) -> str:
    names = [person for person, yes in fell.items() if yes]
    return f"{' and '.join(names)} fell" if names else "nobody fell"
