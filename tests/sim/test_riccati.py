"""The backward pass is the textbook's, in fewer products and less precision."""

import numpy as np
import pytest

from sim.controllers.ilqr.riccati import Dynamics, Quadratic, riccati

NV, NU, H = 5, 3, 8


def problem(seed: int, curvature: float = 1.0) -> tuple[Dynamics, Quadratic]:
    rng = np.random.default_rng(seed)
    change = [0.3 * rng.standard_normal((NV, 2 * NV + NU)) for _ in range(H)]
    by_velocity = 0.1 * np.eye(NV) + 0.01 * rng.standard_normal((H, NV, NV))
    by_position = np.eye(NV) + 0.1 * rng.standard_normal((H, NV, NV))
    root = rng.standard_normal((H + 1, 2, NV, NV))
    dynamics = Dynamics(
        [c.astype(np.float32) for c in change],
        by_velocity.astype(np.float32),
        by_position.astype(np.float32),
    )
    cost = Quadratic(
        rng.standard_normal((H + 1, 2 * NV)),
        (curvature * root @ np.swapaxes(root, -1, -2)).astype(np.float32),
        np.full(NU, 0.5),
        rng.standard_normal((H, NU)),
    )
    return dynamics, cost


def transition(dynamics: Dynamics, h: int) -> np.ndarray:
    change = dynamics.change[h].astype(float)
    moved = dynamics.by_velocity[h].astype(float) @ change
    moved[:, :NV] += dynamics.by_position[h]
    return np.concatenate([moved, change])


def hessian(cost: Quadratic, h: int) -> np.ndarray:
    out = np.zeros((2 * NV, 2 * NV))
    out[:NV, :NV], out[NV:, NV:] = cost.hessian[h]
    return out


def whole_cost(dynamics: Dynamics, cost: Quadratic, gains, steps, x0) -> float:
    """Cost of following gains and steps from a state."""
    x, total = x0, 0.0
    for h in range(H):
        u = steps[h] + gains[h] @ x
        total += cost.control_gradient[h] @ u + 0.5 * u @ (cost.control * u)
        x = transition(dynamics, h) @ np.concatenate([x, u])
        total += cost.gradient[h + 1] @ x + 0.5 * x @ hessian(cost, h + 1) @ x
    return total


@pytest.mark.parametrize("seed", range(3))
def test_gains_and_steps_are_those_of_the_dense_recursion(seed):
    dynamics, cost = problem(seed)
    solved = riccati(dynamics, cost, 1e-3)
    assert solved is not None
    n = 2 * NV
    V, g = hessian(cost, H), cost.gradient[H]
    for h in range(H - 1, -1, -1):
        S = transition(dynamics, h)
        Q, q = S.T @ V @ S, S.T @ g
        quu = Q[n:, n:] + np.diag(cost.control + 1e-3)
        qu = q[n:] + cost.control_gradient[h]
        gain, step = -np.linalg.solve(quu, Q[n:, :n]), -np.linalg.solve(quu, qu)
        np.testing.assert_allclose(solved[0][h], gain, atol=2e-4)
        np.testing.assert_allclose(solved[1][h], step, atol=2e-4)
        V = Q[:n, :n] + Q[n:, :n].T @ gain + hessian(cost, h)
        g = q[:n] + Q[n:, :n].T @ step + cost.gradient[h]


def test_no_other_controls_cost_less():
    dynamics, cost = problem(4)
    solved = riccati(dynamics, cost, 0.0)
    assert solved is not None
    gains, steps = solved
    rng = np.random.default_rng(0)
    x0 = rng.standard_normal(2 * NV)
    least = whole_cost(dynamics, cost, gains, steps, x0)
    for _ in range(20):
        other = steps + 0.05 * rng.standard_normal(steps.shape)
        assert whole_cost(dynamics, cost, gains, other, x0) > least


def test_costs_without_a_least_are_turned_down():
    dynamics, cost = problem(0, curvature=-10.0)
    assert riccati(dynamics, cost, 1e-3) is None
    assert riccati(dynamics, cost, 1e7) is not None


def test_entries_beyond_a_bound_are_clipped():
    dynamics, _ = problem(0)
    assert max(np.abs(c).max() for c in dynamics.clipped(0.1).change) <= 0.1 + 1e-6
    assert dynamics.clipped(0.1).by_velocity is dynamics.by_velocity
