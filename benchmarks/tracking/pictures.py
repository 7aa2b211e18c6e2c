"""Look at what physics did: one picture of eight moments per rollout, and videos.

    python -m benchmarks.tracking.pictures ROLLOUT.npz ... -o DIR [--videos]

In a picture, the upper row is the simulation and the lower one what was asked for, at the same
moments; where touches are labelled, the moment nearest to the first one's middle shows it. A video
shows the two side by side.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.motion import Contact
from robots.errors import DuetError
from sim.gl import choose_backend

MOMENTS = 8
PANEL = 320
"""Edge of a moment in a picture, pixels."""


def main() -> int:
    """Draw and return the exit code."""
    parser = argparse.ArgumentParser(description="Pictures and videos of rollouts")
    parser.add_argument("rollouts", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/bench-track/pictures"))
    parser.add_argument("--videos", action="store_true", help="videos as well")
    args = parser.parse_args()
    choose_backend()
    try:
        for path in args.rollouts:
            for written in draw(path, args.out, videos=args.videos):
                print(written, flush=True)
    except DuetError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


def draw(path: Path, out: Path, *, videos: bool) -> list[Path]:
    """Write the pictures of one rollout and return their paths.

    Raises:
        MotionFileError: The file is not a rollout.
        RenderError: There is no OpenGL that draws offscreen.
    """
    from bridge.film import FPS, film
    from bridge.show import clip_of_rollout
    from sim.render import Painter
    from sim.rollout import Rollout
    from sim.video import write_picture, write_video

    rollout = Rollout.load(path)
    made = clip_of_rollout(rollout)
    asked = replace(made, qpos=rollout.reference_qpos)
    stem = f"{path.parent.name}.{path.stem}"
    index = moments(rollout.times, rollout.contacts)
    camera = made.camera(aspect=1.0)
    with Painter(made.model, width=PANEL, height=PANEL) as painter:
        rows = [
            np.concatenate([painter.paint(clip.qpos[i], camera, i).copy() for i in index], axis=1)
            for clip in (made, asked)
        ]
    picture = out / f"{stem}.png"
    write_picture(picture, np.concatenate(rows, axis=0))
    if not videos:
        return [picture]
    video = out / f"{stem}.mp4"
    write_video(video, film([made, asked]), FPS)
    return [picture, video]


def moments(times: NDArray, contacts: Sequence[Contact], count: int = MOMENTS) -> list[int]:
    """Return indices of moments spread over the time, one of them in the first labelled touch.

    Args:
        times: ``[N]`` s.
        contacts: Labelled touches; may be empty.
        count: How many.
    """
    wanted = np.linspace(0.0, float(times[-1]), count)
    if contacts:
        touch = min(contacts, key=lambda c: c.start)
        middle = min((touch.start + touch.end) / 2, float(times[-1]))
        wanted[np.argmin(np.abs(wanted - middle))] = middle
    return [int(np.argmin(np.abs(times - t))) for t in wanted]


if __name__ == "__main__":
    sys.exit(main())
