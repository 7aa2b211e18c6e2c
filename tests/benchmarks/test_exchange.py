"""The judge of gestures sees what one person does, whoever the other is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.exchange import Judge, asked
from generator.choreographer import Style, exchange
from generator.data.exchanged import Given

LEARNT = ("bow", "wave", "stand")


def given(one: str, other: str, seed: int, *, swap: bool = False) -> Given:
    styles = (Style(swap=swap), Style(swap=swap))
    motion = exchange((one, other), seed=seed, styles=styles)
    return Given(motion, (one, other), styles, ("",))


@pytest.fixture(scope="module")
def judge() -> Judge:
    pairs = [(one, other) for one in LEARNT for other in LEARNT if one != other]
    return Judge([given(*pair, seed) for seed in range(2) for pair in pairs])


def test_gestures_are_told_of_new_performances(judge: Judge) -> None:
    for seed, swap in ((11, False), (12, True)):
        duet = given("bow", "wave", seed, swap=swap)
        assert tuple(judge.sees(duet.motion)) == asked(duet)
    assert asked(given("bow", "wave", 1, swap=True)) == ("wave", "bow")


def test_two_people_who_wave_are_not_taken_for_one_who_bows(judge: Judge) -> None:
    duet = given("wave", "wave", 21)
    assert judge.sees(duet.motion) == ["wave", "wave"]
    turned = replace(duet.motion, a=duet.motion.b, b=duet.motion.a)
    assert judge.sees(turned) == ["wave", "wave"]
