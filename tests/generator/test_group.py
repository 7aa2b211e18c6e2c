"""Groups of more than two people: who keeps away from whom, and who moves alike in two duets."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from generator.runtime.group import ROOM, spread


@given(st.integers(0, 2**31), st.integers(1, 5))
def test_whoever_is_moved_aside_has_room(seed, people) -> None:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, 0.05, (30, people + 1, 2)), axis=0)
    paths = walk + rng.uniform(-1, 1, (people + 1, 2))
    offset = spread(paths[:, 0], paths[:, 1:])
    after = np.linalg.norm(paths[:, :1] + offset - paths[:, 1:], axis=-1).min()
    assert after >= ROOM - 1e-9
    before = np.linalg.norm(paths[:, :1] - paths[:, 1:], axis=-1).min()
    assert before >= ROOM or np.linalg.norm(offset) > ROOM - before - 0.05
    assert before < ROOM or not offset.any()


def test_nobody_is_moved_without_need_or_farther_than_needed() -> None:
    path = np.zeros((10, 2))
    far = np.full((10, 1, 2), [2.0, 0.0])
    np.testing.assert_array_equal(spread(path, far), 0)
    near = np.full((10, 1, 2), [0.5, 0.0])
    np.testing.assert_allclose(spread(path, near), [-0.3, 0], atol=1e-9)
    same = np.zeros((10, 1, 2))
    assert ROOM <= np.linalg.norm(spread(path, same)) < ROOM + 0.06
