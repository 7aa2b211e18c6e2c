"""Long motions out of short windows: parts, seams, places, and the memory they take."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from generator.features import POSITIONS, VELOCITIES, encode
from generator.placement import Placement
from generator.runtime.sequence import (
    Window,
    overlap_of,
    plan,
    put_back,
    seen_from,
    sequence,
)


@given(
    st.lists(st.integers(2, 400), min_size=1, max_size=6),
    st.integers(6, 90),
    st.integers(1, 30),
)
def test_windows_are_no_longer_than_learnt_and_add_up(parts, longest, overlap) -> None:
    overlap = min(overlap, longest // 3)
    parts[0] = max(parts[0], overlap + 1)
    windows = plan(parts, longest, overlap)
    assert max(window.frames for window in windows) <= longest
    assert min(window.frames for window in windows) > overlap
    new = np.zeros(len(parts), int)
    for number, window in enumerate(windows):
        new[window.part] += window.frames - (overlap if number else 0)
    assert new.tolist() == parts
    assert [window.part for window in windows] == sorted(window.part for window in windows)


def test_a_short_part_is_one_window() -> None:
    assert plan([75], 75, 9) == [Window(0, 75)]
    assert plan([49, 49], 75, 9) == [Window(0, 49), Window(1, 58)]
    assert overlap_of(75, 7.5) == 9
    assert overlap_of(12, 30.0) == 4


def test_a_turned_and_moved_frame_is_undone(make_duet) -> None:
    features = encode(make_duet(20))
    placement = Placement(1.1, (0.4, 0.0, -2.0))
    seen = seen_from(features, placement)
    np.testing.assert_allclose(put_back(seen, placement), features, atol=1e-12)
    points = seen[..., POSITIONS].reshape(-1, 2, 22, 3)
    steps = seen[..., VELOCITIES].reshape(-1, 2, 22, 3)
    np.testing.assert_allclose(np.diff(points, axis=0), steps[:-1], atol=1e-9)


def excerpts(features, overlap: int, noise: float = 0.0):
    """A window drawer that knows one long motion and gives it back piece by piece.

    Each window is as the network would give it: in the frame of its own first pose. ``noise``
    makes what it says of the known beginning differ from it, with an offset that lasts.
    """
    start = 0

    def draw(number: int, window: Window, beginning):
        nonlocal start
        piece = features[start : start + window.frames].copy()
        if beginning is None:
            assert number == 0
        else:
            from generator.placement import placement_of

            first = piece[:1, 0, POSITIONS].reshape(1, 22, 3)
            piece = seen_from(piece, placement_of(first))
            np.testing.assert_allclose(beginning, piece[:overlap], atol=1e-9)
            piece[..., POSITIONS] += noise
        start += window.frames - overlap
        return piece

    return draw


def test_windows_of_one_motion_make_that_motion(make_duet) -> None:
    """Turns and places add up over many windows without drift."""
    features = encode(make_duet(100))
    windows = plan([40, 59], 25, 7)
    assert len(windows) > 4
    made = np.concatenate(list(sequence(windows, 7, excerpts(features, 7))))
    np.testing.assert_allclose(made, features, atol=1e-9)


def test_a_seam_fades_from_one_version_to_the_other(make_duet) -> None:
    features = encode(make_duet(60))
    offset, overlap = 0.3, 9
    windows = plan([30, 29], 40, overlap)
    made = np.concatenate(list(sequence(windows, overlap, excerpts(features, overlap, offset))))
    points = (made - features)[..., POSITIONS].reshape(len(made), -1, 3)
    away = np.linalg.norm(points, axis=-1).mean(axis=1)
    seam = slice(30 - overlap - 1, 31)
    np.testing.assert_allclose(away[: 30 - overlap], 0, atol=1e-9)
    np.testing.assert_allclose(away[30:], offset * np.sqrt(3), rtol=1e-6)
    steps = np.diff(away[seam])
    assert (steps >= -1e-12).all()
    assert steps.max() < 2 * offset * np.sqrt(3) / overlap, "the fade is a jump"


def test_only_the_end_of_a_window_is_kept(make_duet) -> None:
    """A sequence is handed on as it grows: nothing waits for its end."""
    features = encode(make_duet(60))
    windows = plan([59], 20, 6)
    pieces = sequence(windows, 6, excerpts(features, 6))
    first = next(pieces)
    assert len(first) == windows[0].frames - 6
    np.testing.assert_allclose(first, features[: len(first)], atol=1e-9)
