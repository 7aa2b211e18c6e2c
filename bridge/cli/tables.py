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


def understood(motion: dict[str, Any]) -> list[str]:
    """Return what the sentences of a motion were taken to mean, as people read it."""
    if "confidence" in motion:
        return [f"{motion['confidence']:.0%} sure"]
    return [f"{m['interaction']} {m['confidence']:.0%} sure" for m in motion.get("understood", ())]


def _lines(summary: dict[str, Any]) -> list[tuple[str, tuple[str, str]]]:
    times = summary["stage_seconds"]
    motion, report, tracking = summary["motion"], summary["report"], summary["tracking"]
    retargeting, performance = summary["retargeting"], summary["performance"]
    what = motion["interaction"] or motion.get("model") or "from a file"
    if "generator" in motion:
        what += f" by {motion['generator']}"
    for meaning in understood(motion):
        what += f", {meaning}"
    off = tracking["mpjpe_global_mm"]
    lines = [
        (
            "generated",
            f"{what}; {motion['seconds']:.1f} s, {len(motion['contacts'])} touches labelled",
        ),
        (
            "tracked",
            f"{off['a']:.0f} / {off['b']:.0f} mm off (a / b), {_ending(tracking)},"
            f" {_recoveries(tracking['recoveries'])}helped with"
            f" {tracking['assist_mean_percent']:.0f} % of body weight",
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


def _recoveries(count: int) -> str:
    return f"caught after {count} stumble{'s' if count > 1 else ''}, " if count else ""


def show_outcome(console: Console, outcome: dict[str, Any]) -> None:
    """Print how tracking one motion went."""
    rows = [
        [title, *(f"{outcome[key][person]:.{digits}f}{unit}" for person in ("a", "b"))]
        for title, key, digits, unit in (
            ("off from the motion", "mpjpe_global_mm", 0, " mm"),
            ("the same, pelvises put together", "mpjpe_root_mm", 0, " mm"),
            ("accelerations off", "accel_error_mm_per_frame2", 1, " mm/frame²"),
            ("below the floor, 95 % of the time", "floor_penetration_p95_mm", 0, " mm"),
        )
    ]
    helped = outcome["assist_max_bodyweight"]
    console.table(
        f"{outcome['simulated_s']:.1f} s with {outcome['controller']}: {_ending(outcome)}",
        ["", "a", "b"],
        rows,
    )
    console.show(
        f"{_recoveries(outcome['recoveries'])}{_touches(outcome)};"
        f" in each other {_inside(outcome)} at most; helped with {helped:.2f} body weights at most;"
        f" {outcome['cpu_seconds_per_second']:.1f} CPU-s and"
        f" {outcome['wall_seconds_per_second']:.1f} s per second"
    )
    least = outcome["least_assist"]
    if least is not None:
        found = (
            f"{least['force_bodyweight']:.2f} body weights"
            if least["trackable"]
            else "no bound suffices"
        )
        console.show(f"least help with which nobody falls: {found} ({len(least['tries'])} runs)")


def show_batch(console: Console, clips: list[dict[str, Any]]) -> None:
    """Print how tracking many motions went, one line each."""
    rows = []
    for clip in clips:
        name, status = Path(clip["folder"]).name, clip["status"]
        if status == "failed":
            rows.append([name, "[red]failed[/]", "", "", "", ""])
            continue
        off = clip["mpjpe_global_mm"]
        rows.append(
            [
                name,
                f"[green]{status}[/]" if clip["success"] else f"[red]{_ending(clip)}[/]",
                f"{off['a']:.0f} / {off['b']:.0f} mm",
                "" if clip["contact_recall"] is None else f"{clip['contact_recall']:.0%}",
                _inside(clip),
                f"{clip['cpu_seconds_per_second']:.1f}",
            ]
        )
    good = sum(bool(clip.get("success")) for clip in clips)
    console.table(
        f"{good} of {len(clips)} motions performed to the end, nobody fell",
        ["", "", "off", "touches", "in each other", "CPU-s/s"],
        rows,
    )
    for clip in clips:
        if clip["status"] == "failed":
            console.show(f"failed: {clip['error']}")


def _ending(outcome: dict[str, Any]) -> str:
    """Return who fell when, and why it ended early if it did."""
    falls = [
        f"{who} fell at {time:.2f} s"
        for who, time in outcome["fall_time_s"].items()
        if time is not None
    ]
    if not outcome["finished"]:
        return "; ".join([*falls, str(outcome["ended_because"])])
    return " and ".join(falls) or "nobody fell"


def _touches(outcome: dict[str, Any]) -> str:
    recall = outcome["contact_recall"]
    return "no touch was wanted" if recall is None else f"{recall:.0%} of wanted touches met"


def _inside(outcome: dict[str, Any]) -> str:
    depth = outcome["penetration_max_mm"]
    return f"{depth['reference']:.0f} → {depth['simulated']:.0f} mm"
