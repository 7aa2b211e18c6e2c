"""Moving and still pictures as files: H.264 in MP4, and PNG."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import av.error
import numpy as np

from robots.errors import RenderError
from robots.files import whole_file
from sim.render import Frame


def write_video(path: str | Path, frames: Iterable[Frame], fps: float) -> int:
    """Write frames as MP4 (H.264, 4:2:0, plays everywhere) and return how many there were.

    Raises:
        RenderError: There are no frames, or the encoder refuses them.
        MotionFileError: The file cannot be written.
    """
    count = 0
    with whole_file(path) as file:
        try:
            with av.open(file, "w", format="mp4", options={"movflags": "faststart"}) as container:
                stream = None
                for frame in frames:
                    if stream is None:
                        stream = container.add_stream("libx264", rate=round(fps))
                        stream.height, stream.width = frame.shape[0] & ~1, frame.shape[1] & ~1
                        stream.pix_fmt = "yuv420p"
                        stream.options = {"crf": "21", "preset": "veryfast"}
                    even = np.ascontiguousarray(frame[: stream.height, : stream.width])
                    picture = av.VideoFrame.from_ndarray(even, format="rgb24")
                    container.mux(stream.encode(picture))
                    count += 1
                if stream is None:
                    raise RenderError("a video needs at least one frame", where=str(path))
                container.mux(stream.encode())
        except av.error.FFmpegError as error:
            raise RenderError(f"the video encoder failed: {error}", where=str(path)) from error
    return count


def write_picture(path: str | Path, frame: Frame) -> None:
    """Write one frame as PNG.

    Raises:
        RenderError: The encoder refuses it.
        MotionFileError: The file cannot be written.
    """
    encoder = av.CodecContext.create("png", "w")
    encoder.width, encoder.height = frame.shape[1], frame.shape[0]
    encoder.pix_fmt = "rgb24"
    encoder.time_base = Fraction(1)
    try:
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
        packets = [*encoder.encode(picture), *encoder.encode(None)]
    except av.error.FFmpegError as error:
        raise RenderError(f"the picture encoder failed: {error}", where=str(path)) from error
    with whole_file(path) as file:
        for packet in packets:
            file.write(bytes(packet))
