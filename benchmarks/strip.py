"""The picture of eight sentences in the README, one panel each.

    python -m benchmarks.strip [-o docs/eight-sentences.png] [--generator NAME] [--weights DIR]

Motions are drawn as they come out of the generator, without physics, at the moment that tells most
(``strip.toml``). The camera stands across the line between the two and shows nothing else.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bridge.generating import GENERATORS, default_generator, make
from bridge.player.canvas import ROWS, Canvas
from generator.motion import DuetMotion
from generator.training.toml import build, read_toml
from robots.errors import DuetError, SpecError, nearest
from sim.gl import choose_backend

if TYPE_CHECKING:  # MuJoCo is imported when it knows how to draw
    from sim.render import Frame

PANELS = Path(__file__).with_name("strip.toml")
OUT = Path("docs/eight-sentences.png")
COLUMNS = 4
EDGE = 300
"""Of a panel, pixels."""
SMOOTH = 2
"""A panel is drawn so many times larger and then averaged, for smooth edges."""
GAP, SCALE, LINES = 6, 2, 2
"""Pixels between panels; size of the letters, and lines of them, below each."""
PITCH = -8.0
"""Of the line of sight, degrees: nearly level, so that outlines are those that people know."""


def touch(motion: DuetMotion) -> NDArray[np.float64]:
    """Return ``[T]``, highest where the longest touch is closest; any hands if there is none."""
    if not motion.contacts:
        hands = [[p.point(f"{side}_hand") for side in ("left", "right")] for p in motion.people]
        gaps = [np.linalg.norm(one - other, axis=1) for one in hands[0] for other in hands[1]]
        return -np.min(gaps, axis=0)
    longest = max(motion.contacts, key=lambda contact: contact.end - contact.start)
    times, middle = motion.a.times, (longest.start + longest.end) / 2
    within = (longest.start <= times) & (times <= longest.end)
    within |= np.abs(times - middle) <= np.abs(times - middle).min()
    return np.where(within, -motion.gap(longest) - 0.01 * np.abs(times - middle), -np.inf)


def low(motion: DuetMotion) -> NDArray[np.float64]:
    """Return ``[T]``, highest where heads are lowest, in a touch if there is one."""
    heads = np.mean([person.point("head")[:, 2] for person in motion.people], axis=0)
    times = motion.a.times
    within = [(c.start <= times) & (times <= c.end) for c in motion.contacts]
    return np.where(np.any(within, axis=0), -heads, -np.inf) if within else -heads


def kick(motion: DuetMotion) -> NDArray[np.float64]:
    """Return ``[T]``, highest where a leg is stretched: a foot is high and far from the pelvis."""
    scores = []
    for person in motion.people:
        for side in ("left", "right"):
            foot, pelvis = person.point(f"{side}_foot"), person.point("pelvis")
            scores.append(foot[:, 2] + np.linalg.norm((foot - pelvis)[:, :2], axis=1))
    return np.max(scores, axis=0)


MOMENTS: dict[str, Callable[[DuetMotion], NDArray[np.float64]]] = {
    "touch": touch,
    "low": low,
    "kick": kick,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One sentence and which moment shows it.

    Raises:
        SpecError: There is no such moment.
    """

    text: str
    """The sentence."""
    moment: str
    """One of :data:`MOMENTS`."""
    turn: float = 12.0
    """How far the line of sight is turned from straight across, degrees."""
    seed: int = 0
    """Of the motion."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.moment not in MOMENTS:
            raise SpecError(
                f"no moment '{self.moment}'",
                where=self.text,
                allowed=", ".join(MOMENTS),
                hint=nearest(self.moment, MOMENTS),
            )


@dataclass(frozen=True, slots=True)
class Strip:
    """All panels."""

    panel: tuple[Panel, ...]
    """Row by row."""


def main() -> int:
    """Draw and return the exit code."""
    parser = argparse.ArgumentParser(description="A picture of eight sentences")
    parser.add_argument("-o", "--out", type=Path, default=OUT)
    parser.add_argument("--generator", choices=GENERATORS[:2], default=default_generator())
    parser.add_argument("--weights", default="", help="a model, for diffusion")
    parser.add_argument("--panels", type=Path, default=PANELS, help="which sentences")
    parser.add_argument("--seed", type=int, help="instead of those of the panels")
    args = parser.parse_args()
    choose_backend()
    from generator.runtime.request import DiffusionRequest
    from sim.video import write_picture

    request = DiffusionRequest(weights=args.weights)
    try:
        drawn = []
        for panel in load_panels(args.panels):
            seed = panel.seed if args.seed is None else args.seed
            motion, _ = make(panel.text, seed=seed, generator=args.generator, diffusion=request)
            drawn.append((panel.text, picture(motion, panel.moment, turn=panel.turn)))
            print(panel.text, flush=True)
        write_picture(args.out, joined(drawn))
    except DuetError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(f"{args.out}: {args.generator}")
    return 0


def load_panels(path: Path = PANELS) -> tuple[Panel, ...]:
    """Return the panels of a file.

    Raises:
        SpecError: It cannot be read, or says something unknown.
    """
    return build(Strip, read_toml(path), where=str(path)).panel


def picture(motion: DuetMotion, moment: str, *, turn: float = 12.0) -> Frame:
    """Return both people ``[EDGE, EDGE, 3]`` at the moment that tells most.

    Raises:
        RenderError: There is no OpenGL that draws offscreen.
    """
    from bridge.show import clip_of_motion
    from sim.camera import follow
    from sim.clip import Clip
    from sim.render import Painter

    clip = clip_of_motion(motion)
    index = int(np.argmax(MOMENTS[moment](motion)))
    pose = Clip(clip.model, clip.qpos[index : index + 1], clip.fps)
    camera = follow(pose.points("a/"), pose.points("b/"), fps=clip.fps, turn=turn, elevation=PITCH)
    size = EDGE * SMOOTH
    with Painter(clip.model, width=size, height=size) as painter:
        large = painter.paint(pose.qpos[0], camera, 0)
    blocks = large.reshape(EDGE, SMOOTH, EDGE, SMOOTH, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


def joined(panels: list[tuple[str, Frame]]) -> Frame:
    """Return the panels in rows, each with its sentence below."""
    below = LINES * (ROWS + 3) * SCALE + 2 * GAP
    rows = -(-len(panels) // COLUMNS)
    canvas = Canvas(COLUMNS * (EDGE + GAP) - GAP, rows * (EDGE + below))
    for number, (text, frame) in enumerate(panels):
        left, top = number % COLUMNS * (EDGE + GAP), number // COLUMNS * (EDGE + below)
        canvas.pixels[top : top + EDGE, left : left + EDGE] = frame
        letters = EDGE // (6 * SCALE)
        for line, words in enumerate(textwrap.wrap(text, letters)[:LINES]):
            indent = (EDGE - len(words) * 6 * SCALE) // 2
            down = top + EDGE + GAP + line * (ROWS + 3) * SCALE
            canvas.text(left + indent, down, words, scale=SCALE)
    return canvas.pixels


if __name__ == "__main__":
    sys.exit(main())
