"""Duets, spoilt the way a network errs, and finished."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from benchmarks.spoiling import spoil
from generator.choreographer import choreograph
from generator.finishing import Changes, finish_with_changes
from generator.motion import DuetMotion


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    original: DuetMotion
    spoilt: DuetMotion
    made: DuetMotion
    changes: Changes


@pytest.fixture(scope="session", params=["handshake", "walk_together"])
def case(request: pytest.FixtureRequest) -> Case:
    original = choreograph(request.param, seed=0)
    spoilt = spoil(original, seed=0)
    return Case(original, spoilt, *finish_with_changes(spoilt))


@pytest.fixture(scope="session")
def handshake() -> DuetMotion:
    return choreograph("handshake", seed=1)
