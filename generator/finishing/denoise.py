"""Takes jitter out of a signal and leaves its accents.

**The problem.** Frames that a network draws do not quite agree with their neighbours: jerk is
several times that of people. One low-pass for everything that removes it also rounds off every
clap, punch and footfall. So the signal is split into bands (differences of ever wider Gaussians),
and each band is kept, moment by moment, as far as it is stronger there than noise would be: the
local Wiener gain

    gain = max(0, 1 - noise / energy)

with the energy of the band around the moment, and what white noise of the measured size leaves in
that band. Noise is measured by the fourth difference, which takes out what is smooth over five
frames. Noise is there all the time and movement comes and goes, but at low frame rates five frames
hold a whole wave of a hand; so the quiet quarter of the time tells how large noise is. All filters
are symmetric, so nothing moves in time.

Example: of 5 mm of jitter per frame on a slow wave at 15 frames per second, 2.6 mm of slow wander
remain and 1 % of the third difference, which is jerk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from robots.skeleton import FloatArray

_WIDTHS = (0.6, 1.2, 2.4)
"""Standard deviations of the Gaussians between bands, frames."""
_AROUND = 2.5
"""Width of the window of local energy, as a multiple of the wider Gaussian of the band."""
_DOUBT = 3.0
"""Energy, over that of noise, from which a band begins to be kept: energy of noise varies."""
_ORDER = 4
_GAIN = 70.0
"""Variance of the fourth difference of white noise of variance 1: sum of squared binomials."""
_QUIET = 25
"""Percentile of the fourth difference that tells the noise."""
_QUIET_SIZE = 0.31864
"""That percentile of the size of a normal number of variance 1."""


def noise_of(signal: NDArray) -> FloatArray:
    """Return the standard deviation ``[J]`` of the white noise in signals ``[T, J, C]``."""
    if len(signal) <= _ORDER:
        return np.zeros(signal.shape[1])
    rough = np.abs(np.diff(signal, _ORDER, axis=0)) / np.sqrt(_GAIN)
    spread = np.percentile(rough, _QUIET, axis=0) / _QUIET_SIZE
    return np.sqrt((spread**2).mean(axis=-1))


def denoise(signal: NDArray, strength: float = 1.0, usual: float = 0.0) -> FloatArray:
    """Return ``[T, J, C]`` without what looks like noise; gains are shared by the C components.

    Args:
        signal: Time along the first axis.
        strength: Factor on the measured noise; 0 changes nothing.
        usual: Noise that clean signals seem to have, in units of the signal.
    """
    signal = np.asarray(signal, dtype=float)
    noise = strength * np.sqrt(np.maximum(noise_of(signal) ** 2 - usual**2, 0.0))
    if len(signal) <= _ORDER or not noise.any():
        return signal.copy()
    margin = min(round(4 * _WIDTHS[-1]), len(signal) - 1)
    rest = _continued(signal, margin)
    out = np.zeros_like(rest)
    for width, remaining in zip(_steps(), _BAND_VARIANCES, strict=True):
        smooth = gaussian_filter1d(rest, width, axis=0, mode="nearest")
        band = rest - smooth
        energy = gaussian_filter1d((band**2).mean(axis=-1), _AROUND * width, axis=0, mode="nearest")
        expected = _DOUBT * remaining * noise**2
        out += band * np.maximum(1 - expected / np.maximum(energy, 1e-18), 0.0)[..., None]
        rest = smooth
    return (out + rest)[margin : margin + len(signal)]


def _continued(signal: NDArray, margin: int) -> FloatArray:
    """Return the signal with both ends continued point-symmetrically, so that trends go on."""
    before = 2 * signal[0] - signal[margin:0:-1]
    after = 2 * signal[-1] - signal[-2 : -margin - 2 : -1]
    return np.concatenate([before, signal, after])


def _steps() -> FloatArray:
    """Return the widths of the Gaussians that, one after another, give those of the bands."""
    return np.sqrt(np.diff(np.square((0.0, *_WIDTHS))))


def _band_variances() -> FloatArray:
    """Return the variance of white noise of variance 1 in each band."""
    rest = np.zeros(101)
    rest[50] = 1.0
    variances = []
    for width in _steps():
        smooth = gaussian_filter1d(rest, width)
        variances.append(float(((rest - smooth) ** 2).sum()))
        rest = smooth
    return np.array(variances)


_BAND_VARIANCES = _band_variances()
