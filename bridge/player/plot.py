"""A picture of a performance: goal, present, lag, current and temperature over time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bridge.player.canvas import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PALE,
    PALETTE,
    RED,
    Box,
    Canvas,
    Colour,
)
from bridge.player.replay import Replay, Track
from robots.skeleton import FloatArray
from sim.video import write_picture

COLUMN, LEFT, RIGHT = 800, 170, 20
"""Pixels of one robot's column, of its labels, and of the space behind it."""
HEAD, STRIP, PANEL, GAP = 56, 46, 120, 10
"""Heights in pixels: the title, one joint, one of the panels below, and between two of them."""
LEAST_SPAN = math.radians(5)
"""rad that a joint's strip spans at least: noise shall not look like motion."""

Curve = tuple[FloatArray, FloatArray, Colour]
"""x, y and colour."""


def plot(told: Replay, path: str | Path) -> None:
    """Write a PNG: a column per robot, a strip per joint, then lag, current and temperature.

    Goals are orange, positions blue; upright lines are changes of state, red ones faults.

    Raises:
        MotionFileError: The file cannot be written.
        RenderError: The encoder refuses it.
    """
    strips = max((len(track.joints) for track in told.tracks), default=0)
    height = HEAD + strips * STRIP + 3 * (PANEL + GAP) + 40
    canvas = Canvas(COLUMN * max(1, len(told.tracks)), height + height % 2)
    for number, track in enumerate(told.tracks):
        _column(canvas, number * COLUMN, track, told, HEAD + strips * STRIP + GAP)
    write_picture(path, canvas.pixels)


def _column(canvas: Canvas, left: int, track: Track, told: Replay, below: int) -> None:
    end = float(track.times[-1]) if len(track.times) else 1.0
    span = (0.0, max(end, 1e-3))
    found = told.performance.tracking[track.person]
    canvas.text(left + 10, 8, f"{track.person}: {track.robot}, {told.performance.outcome}"[:62])
    numbers = (
        f"{_number(found.rms_deg, 2)}° rms, {_number(found.max_deg, 1)}° at most"
        f" ({found.worst_joint or '-'}), {_number(found.lag_ms, 0)} ms behind"
    )
    canvas.text(left + 10, 30, numbers[:62], GREY)
    for index, name in enumerate(track.joints):
        box = (left + LEFT, HEAD + index * STRIP, COLUMN - LEFT - RIGHT, STRIP - 4)
        goal, present = np.degrees(track.goal[:, index]), np.degrees(track.present[:, index])
        curves = [(track.times, goal, ORANGE), (track.times, present, BLUE)]
        low, high = _bounds(curves, math.degrees(LEAST_SPAN))
        _panel(canvas, box, span, (low, high), curves, told)
        canvas.text(left + 10, box[1] + 2, name[:13])
        canvas.text(left + 10, box[1] + 22, f"{round(low)} to {round(high)}°", GREY)
    for row, (title, curves, least) in enumerate(_panels(track)):
        box = (left + LEFT, below + row * (PANEL + GAP), COLUMN - LEFT - RIGHT, PANEL)
        low, high = _bounds(curves, least)
        _panel(canvas, box, span, (low, high), curves, told)
        canvas.text(left + 10, box[1] + 2, title)
        canvas.text(left + 10, box[1] + 24, f"{high:.3g}", GREY)
        canvas.text(left + 10, box[1] + PANEL - 18, f"{low:.3g}" if curves else "none", GREY)
    foot = below + 3 * (PANEL + GAP) + 4
    canvas.text(left + LEFT, foot, "0 s", BLACK)
    text = f"{end:.1f} s"
    canvas.text(left + COLUMN - RIGHT - 12 * len(text), foot, text, BLACK)


def _panels(track: Track) -> list[tuple[str, list[Curve], float]]:
    """Return title, curves and least height of each panel below the joints."""
    colours = [PALETTE[index % len(PALETTE)] for index in range(len(track.joints))]
    current: list[Curve] = [
        (track.times, column, colour)
        for column, colour in zip(track.current.T, colours, strict=True)
        if np.isfinite(column).any()
    ]
    temperature: list[Curve] = [
        (*track.temperature[name], colour)
        for name, colour in zip(track.joints, colours, strict=True)
        if name in track.temperature
    ]
    times, lags = track.lags()
    lag: list[Curve] = [(times, lags, BLUE)] if len(times) else []
    return [("lag, ms", lag, 20.0), ("current, A", current, 0.1), ("heat, °C", temperature, 5.0)]


def _panel(
    canvas: Canvas,
    box: Box,
    span: tuple[float, float],
    bounds: tuple[float, float],
    curves: Iterable[Curve],
    told: Replay,
) -> None:
    canvas.frame(box)
    for time, what in told.events:
        canvas.upright(box, span, time, RED if what.startswith("fault") else PALE)
    for x, y, colour in curves:
        if len(x) == 1:  # one look is a level, not a line
            x, y = np.array([span[0], span[1]]), np.array([y[0], y[0]])
        canvas.curve(box, span, bounds, x, y, colour)


def _bounds(curves: Iterable[Curve], least: float) -> tuple[float, float]:
    """Return what the y axis spans: all finite values, and at least ``least``."""
    values = [y[np.isfinite(y)] for _, y, _ in curves]
    every = np.concatenate(values) if values else np.zeros(0)
    if not len(every):
        return 0.0, least
    low, high = float(every.min()), float(every.max())
    spare = max(0.0, least - (high - low)) / 2
    return low - spare, high + spare


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
