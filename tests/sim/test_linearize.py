"""The derivatives of a step agree with differences of steps, whatever the feet do."""

import mujoco
import numpy as np
import pytest

from robots.errors import SpecError
from robots.humanoid import HumanBody
from robots.skeleton import human_skeleton
from sim.controllers.ilqr.linearize import Linearizer, transition
from sim.controllers.ilqr.person import person_model
from sim.scene import AssistLimits, build_scene


@pytest.fixture(scope="module")
def person():
    """A planning model with a ghost and a root assist, at the controller's rate."""
    body = HumanBody.of(human_skeleton())
    return person_model(build_scene((body, body), timestep=1 / 60, assist=AssistLimits()), 0)


def state(person, seed: int, *, drop: float = -0.004, velocity=(0, 0, 0), ghost=(5, 5, 0)):
    """Return data of a person near the rest pose, with soles at a height and targets astray."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(person.model)
    data.mocap_pos[:] += ghost
    data.qpos[2] += drop
    data.qvel[:] = 0.3 * rng.standard_normal(person.nv)
    data.qvel[:3] += velocity
    data.ctrl[person.targets] = 0.1 * rng.standard_normal(person.nu)
    turn = np.zeros(person.nv)
    turn[6:] = 0.05 * rng.standard_normal(person.nv - 6)
    mujoco.mj_integratePos(person.model, data.qpos, turn, 1.0)
    mujoco.mj_forward(person.model, data)
    data.qacc_warmstart[:] = data.qacc
    return data


def derivatives(person, data, **kwargs):
    """Return A, B and the verdict."""
    linearize = Linearizer(person.model, **kwargs)
    change, good = linearize(data)
    stepped = state_after(person, data)
    both = transition(change, linearize.update, stepped)
    return both[:, : 2 * person.nv], both[:, 2 * person.nv :], good


def state_after(person, data):
    """Return the velocity after a step, without taking it."""
    copy = mujoco.MjData(person.model)
    mujoco.mj_copyData(copy, person.model, data)
    mujoco.mj_step(person.model, copy)
    return copy.qvel.copy()


def centred(person, data):
    """Return A and B by centred differences of whole steps."""
    A = np.empty((2 * person.nv, 2 * person.nv))
    B = np.empty((2 * person.nv, person.model.nu))
    mujoco.mjd_transitionFD(person.model, data, 1e-7, True, A, B, None, None)
    return A, B


STATES = {
    "in_the_air": {"drop": 0.2},
    "on_two_feet": {"drop": -0.02},
    "on_edges": {"drop": -0.004},
    "landing": {"drop": -0.01, "velocity": (0.3, 0, -0.5)},
    "sliding": {"drop": -0.02, "velocity": (3.0, 1.0, 0)},
    "against_a_partner": {"drop": -0.02, "ghost": (0.2, 0.1, 0)},
}


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_agree_with_centred_differences(person, name, seed):
    data = state(person, seed, **STATES[name])
    assert (data.ncon > 0) == (name != "in_the_air")
    of_state, of_input = centred(person, data)
    A, B, good = derivatives(person, data)
    assert good
    assert np.linalg.norm(A - of_state) < 1e-3 * np.linalg.norm(of_state)
    assert np.linalg.norm(B - of_input) < 1e-4 * np.linalg.norm(of_input)


def test_a_step_is_predicted_from_its_neighbour(person):
    model, nv = person.model, person.nv
    data = state(person, 1, **STATES["on_two_feet"])
    A, B, _ = derivatives(person, data)
    rng = np.random.default_rng(7)
    change = 1e-5 * rng.standard_normal(2 * nv)
    more = 1e-5 * rng.standard_normal(model.nu)
    steps = []
    for scale in (0.0, 1.0):
        near = state(person, 1, **STATES["on_two_feet"])
        mujoco.mj_integratePos(model, near.qpos, scale * change[:nv], 1.0)
        near.qvel += scale * change[nv:]
        near.ctrl += scale * more
        mujoco.mj_step(model, near)
        steps.append((near.qpos.copy(), near.qvel.copy()))
    moved = np.empty(nv)
    mujoco.mj_differentiatePos(model, moved, 1.0, steps[0][0], steps[1][0])
    moved = np.concatenate([moved, steps[1][1] - steps[0][1]])
    predicted = A @ change + B @ more
    assert np.linalg.norm(moved - predicted) < 1e-2 * np.linalg.norm(moved)


def test_state_and_inputs_are_left_as_they_were(person):
    data = state(person, 2, **STATES["landing"])
    names = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")
    before = [getattr(data, n).copy() for n in names]
    Linearizer(person.model)(data)
    for name, value in zip(names, before, strict=True):
        assert np.array_equal(getattr(data, name), value), name


@pytest.mark.parametrize("exact", [False, True])
def test_steep_derivatives_are_taken_again_over_a_wide_step_and_clipped(person, exact):
    data = state(person, 5, **STATES["against_a_partner"])
    assert np.abs(centred(person, data)[0]).max() > 1000
    A, B, good = derivatives(person, data, exact=exact)
    assert not good
    assert np.abs(A[person.nv :]).max() <= 1000
    assert np.isfinite(A).all()
    assert np.isfinite(B).all()


def test_other_integrators_are_refused():
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(SpecError, match="discrete"):
        Linearizer(model)


def test_exact_derivatives_are_those_of_mujoco(person):
    data = state(person, 0, **STATES["on_two_feet"])
    A, B, good = derivatives(person, data, exact=True)
    of_state, of_input = centred(person, data)
    assert good
    assert np.linalg.norm(A - of_state) < 0.1 * np.linalg.norm(of_state)
    assert np.linalg.norm(B - of_input) < 1e-4 * np.linalg.norm(of_input)
