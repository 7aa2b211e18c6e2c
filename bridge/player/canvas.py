"""Lines and labels on pixels: what a plot needs, without a plotting library."""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

Colour = tuple[int, int, int]
Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels."""
WHITE, BLACK, GREY, PALE = (255, 255, 255), (30, 30, 30), (150, 150, 150), (225, 225, 225)
RED, BLUE, ORANGE = (205, 40, 40), (30, 90, 200), (240, 130, 20)
PALETTE: tuple[Colour, ...] = (
    *(BLUE, (220, 120, 20), (20, 140, 70), (140, 60, 170), (0, 150, 170)),
    *((170, 110, 60), (220, 90, 150), (110, 110, 20), (90, 90, 120), RED),
)
"""Colours of lines that share a box."""
ROWS, COLUMNS = 7, 5


class Canvas:
    """A white picture that lines and labels are drawn on; what lies outside is cut off."""

    def __init__(self, width: int, height: int) -> None:
        """Take a size in pixels."""
        self.pixels: NDArray[np.uint8] = np.full((height, width, 3), 255, np.uint8)
        """``[H, W, 3]``, RGB."""

    def text(self, left: int, top: int, text: str, colour: Colour = BLACK, scale: int = 2) -> None:
        """Write a line; characters are ``6 * scale`` wide, unknown ones become boxes."""
        for index, character in enumerate(text):
            dots = _glyph(character).repeat(scale, 0).repeat(scale, 1)
            at = left + index * (COLUMNS + 1) * scale
            region = self.pixels[top : top + dots.shape[0], at : at + dots.shape[1]]
            region[dots[: region.shape[0], : region.shape[1]]] = colour

    def frame(self, box: Box) -> None:
        """Draw the border of a box."""
        left, top, width, height = box
        self.pixels[top, left : left + width] = PALE
        self.pixels[top + height - 1, left : left + width] = PALE
        self.pixels[top : top + height, left] = PALE
        self.pixels[top : top + height, left + width - 1] = PALE

    def curve(
        self,
        box: Box,
        span: tuple[float, float],
        bounds: tuple[float, float],
        x: FloatArray,
        y: FloatArray,
        colour: Colour,
    ) -> None:
        """Draw ``y [N]`` over ``x [N]`` into a box; it has gaps where ``y`` is not finite.

        Args:
            box: Where.
            span: Values of x at the left and right side.
            bounds: Values of y at the bottom and top.
            x: Ascending.
            y: As many.
            colour: Of the line.
        """
        left, top, width, height = box
        across = (np.asarray(x) - span[0]) / max(span[1] - span[0], 1e-9) * (width - 3)
        up = (np.asarray(y) - bounds[0]) / max(bounds[1] - bounds[0], 1e-9) * (height - 5)
        solid = np.isfinite(across) & np.isfinite(up)
        steps = np.flatnonzero(solid[:-1] & solid[1:])
        if not len(steps):
            return
        dx, dy = np.diff(across)[steps], np.diff(up)[steps]
        counts = np.ceil(np.maximum(np.abs(dx), np.abs(dy))).astype(int) + 1
        which = np.repeat(np.arange(len(steps)), counts)
        share = (np.arange(len(which)) - np.repeat(counts.cumsum() - counts, counts)) / counts[
            which
        ]
        column = np.rint(across[steps][which] + share * dx[which]).astype(int)
        row = height - 3 - np.rint(up[steps][which] + share * dy[which]).astype(int)
        inside = (column >= 0) & (column < width - 2) & (row >= 1) & (row < height - 1)
        for thick in (0, 1):
            self.pixels[top + row[inside] - thick, left + 1 + column[inside]] = colour

    def upright(self, box: Box, span: tuple[float, float], x: float, colour: Colour) -> None:
        """Draw a line from bottom to top of a box at one value of x."""
        left, top, width, height = box
        at = round((x - span[0]) / max(span[1] - span[0], 1e-9) * (width - 3))
        if 0 <= at < width - 2:
            self.pixels[top + 1 : top + height - 1, left + 1 + at] = colour


@cache
def _font() -> dict[str, NDArray[np.bool_]]:
    text = (resources.files("bridge.player") / "font.txt").read_text("utf-8")
    font: dict[str, NDArray[np.bool_]] = {" ": np.zeros((ROWS, COLUMNS), bool)}
    for line in text.splitlines():
        character, *rows = line.split(" ")
        if len(rows) == ROWS:
            bits = np.array([int(row, 16) for row in rows])[:, None]
            font[character] = (bits >> np.arange(COLUMNS - 1, -1, -1) & 1).astype(bool)
    return font


def _glyph(character: str) -> NDArray[np.bool_]:
    font = _font()
    glyph = font.get(character, font.get(character.lower()))
    return np.ones((ROWS, COLUMNS), bool) if glyph is None else glyph
