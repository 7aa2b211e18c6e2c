"""The demo's video: the two people of the physics on the left, the two puppets on the right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np

from sim.clip import Clip
from sim.render import Frame, Painter

FPS = 30.0
PANEL = 480
"""Edge of a panel, pixels."""


def frame_count(clips: Sequence[Clip], fps: float = FPS) -> int:
    """Return how many frames a film of these clips has: as long as the longest."""
    return max(len(clip.at_rate(fps).qpos) for clip in clips)


def film(clips: Sequence[Clip], *, fps: float = FPS, panel: int = PANEL) -> Iterator[Frame]:
    """Yield frames that show clips side by side on one clock; a short one holds its last pose.

    Args:
        clips: One per panel, left to right. One alone gets a wider panel.
        fps: Of the film.
        panel: Height of the film, and width of each panel where there are several, pixels.

    Raises:
        RenderError: There is no OpenGL that draws offscreen.
    """
    width = panel * 4 // 3 if len(clips) == 1 else panel
    paced = [clip.at_rate(fps) for clip in clips]
    cameras = [clip.camera(aspect=width / panel) for clip in paced]
    with ExitStack() as stack:
        painters = [
            stack.enter_context(Painter(clip.model, width=width, height=panel)) for clip in paced
        ]
        for index in range(frame_count(clips, fps)):
            panels = []
            for clip, camera, painter in zip(paced, cameras, painters, strict=True):
                moment = min(index, len(clip.qpos) - 1)
                panels.append(painter.paint(clip.qpos[moment], camera, moment))
            yield np.concatenate(panels, axis=1)


class FrameKeeper(Iterator[Frame]):
    """Passes frames on and keeps one of them in :attr:`kept` (the last, if there are fewer)."""

    def __init__(self, frames: Iterator[Frame], index: int) -> None:
        """Take the frames and which to keep."""
        self._frames = enumerate(frames)
        self._index = index
        self.kept: Frame = np.zeros((1, 1, 3), np.uint8)

    def __next__(self) -> Frame:
        """Return the next frame."""
        index, frame = next(self._frames)
        if index <= self._index:
            self.kept = frame
        return frame
