"""Who leans on whom, read off the reference."""

from __future__ import annotations

import pytest

from benchmarks.tracking.clips import clips_of
from benchmarks.tracking.leaning import LEANS as DUETS
from benchmarks.tracking.leaning import leaning as leaning_duet
from generator.choreographer import choreograph
from generator.given import cut_motion
from generator.motion import DuetMotion
from sim.reference import make_reference
from sim.scene import build_scene
from sim.support import LEANS, leaning


def outside(motion: DuetMotion) -> tuple[float, float]:
    reference = make_reference(motion)
    return leaning(build_scene(reference.bodies), reference)


@pytest.mark.parametrize("name", DUETS)
def test_somebody_leans_in_every_duet_of_people_who_bear_each_others_weight(name):
    assert max(outside(cut_motion(leaning_duet(name), 0.0, 2.4))) > 2 * LEANS


@pytest.mark.parametrize("name", ["waltz", "push", "hug", "walk_together"])
def test_people_who_dance_push_hug_and_walk_stand_over_their_own_feet(name):
    assert max(outside(choreograph(name, seed=3))) < 0


def test_noise_makes_nobody_lean():
    hug = next(clip for clip in clips_of("dirty")[9:] if clip.interaction == "hug")
    assert max(outside(hug.load())) < LEANS / 2


def test_people_lean_further_outside_as_they_tip_further():
    steeper = [outside(cut_motion(leaning_duet("backs", tip), 0.0, 2.2))[0] for tip in (0, 5, 10)]
    assert steeper[0] < 0 < steeper[1] < steeper[2] < 0.2
