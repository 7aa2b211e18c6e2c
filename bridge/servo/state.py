"""What servos report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ServoState:
    """What the servos of a bus reported at one time; arrays follow :attr:`ServoBus.joint_names`."""

    time: float
    """s, when the answers were complete."""
    position: FloatArray
    """``[D]`` rad of the joint; NaN where a servo did not answer."""
    velocity: FloatArray
    """``[D]`` rad/s of the joint; NaN likewise."""
    current: FloatArray
    """``[D]`` A; NaN likewise and where the model does not measure it."""
    seen: NDArray[np.bool_]
    """``[D]`` who answered."""
    alert: NDArray[np.bool_]
    """``[D]`` who has a hardware error."""
