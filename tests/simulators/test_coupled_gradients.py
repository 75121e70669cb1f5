"""Gradients with coupled damping by complex modes: against complex steps, and where they give up."""

import numpy as np
import pytest

from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.linear import system
from support.kernels import linear_misfit_gradient, linear_population_gradient
from support.linear import meeting, noise, spring_chain
from support.reference import first_order_hold, interpolated

pytestmark = pytest.mark.slow  # they wait for kernels

N_TIMES, DT, NONE = 121, 0.02, np.zeros(0, dtype=int)


class Stacks:
    """M_0 + theta_0 M_1, C_0 + theta_1 C_1 and K_0 + theta_2 K_1, with three sensors and their data."""

    def __init__(self, mass, damping, stiffness, *, force=None, grid=(1, 1), quantity=0, gaps=False):
        self.matrices, self.grid, self.quantity = (mass, damping, stiffness), grid, quantity
        n = self.n = len(mass[0])
        self.influence = np.ones((n, 1)) if force is None else np.zeros((n, 1))
        self.forces = np.zeros((n, 1)) if force is None else force
        self.inputs, self.sensors = noise(n, (1, N_TIMES)), noise(n + 1, (3, n))
        self.data = noise(5, (3, ((N_TIMES - 1) * grid[0]) // grid[1] + 1))
        if gaps:
            self.data[1, 20:40] = np.nan

    def arguments(self, theta):
        none = np.zeros((self.n, self.n))
        stacks = [
            np.array([pair[0], *(pair[1] if i == k else none for k in range(3))]).reshape(4, -1)
            for i, pair in enumerate(self.matrices)
        ]
        rest = self.influence, self.forces, self.inputs, DT, *self.grid, self.sensors, self.n, self.quantity
        rayleigh, ratios = np.zeros(2), np.zeros(self.n)
        if theta.ndim == 2:
            rayleigh, ratios = rayleigh[None], ratios[None]
        return theta, rayleigh, ratios, *stacks, NONE, NONE, *rest

    def exact(self, theta, weights):
        """The gradient by complex steps through a matrix exponential, without modes."""
        return np.array([self.sum(theta + 1e-30j * e, weights).imag / 1e-30 for e in np.eye(3)])

    def sum(self, theta, weights):
        mass, damping, stiffness = (
            pair[0] + t * pair[1] for t, pair in zip(theta, self.matrices, strict=True)
        )
        load = self.forces - mass @ self.influence
        inputs, (substeps, stride) = interpolated(self.inputs, self.grid[0]), self.grid
        system = [np.linalg.solve(mass, a) for a in (damping, stiffness, load)]
        x, v, a = first_order_hold(*system, inputs, DT / substeps, stride)
        response = self.sensors @ (a + self.influence @ inputs[:, ::stride], a, v, x)[self.quantity]
        squares = np.where(np.isnan(self.data), 0.0, (np.nan_to_num(self.data) - response) ** 2)
        return weights @ squares.mean(axis=1)


def error(case, thetas):
    """Largest error of a gradient by one parameter, of the largest of them in the population."""
    weights = noise(6, (len(thetas), 3))
    found = linear_population_gradient(*case.arguments(thetas), case.data, weights)[0]
    exact = np.array([case.exact(t, w) for t, w in zip(thetas, weights, strict=True)])
    one = linear_misfit_gradient(*case.arguments(thetas[0]), case.data, weights[0][:, None])[0]
    np.testing.assert_allclose(one, found[0], rtol=0, atol=1e-12 * abs(found[0]).max())
    return (abs(found - exact) / abs(exact).max(axis=0)).max()


@pytest.fixture
def alone(monkeypatch):
    """Structures that went the slow way."""
    found, solve = [], system.solve_system
    monkeypatch.setattr(system, "solve_system", lambda a, **more: found.append(a) or solve(a, **more))
    return found


ASKED = {name: {"quantity": q} for q, name in enumerate(QUANTITIES)} | {
    "substeps": {"grid": (3, 1)},
    "stride": {"grid": (1, 4)},
    "gaps": {"gaps": True},
    "force": {"force": np.eye(5)[:, [4]], "quantity": 3, "grid": (2, 3)},
}


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_against_complex_steps(asked, alone):
    """By M, C and K, of a chain with a dashpot at its top, all of it in lanes."""
    stiffness, own = spring_chain(5, 1800.0).toarray(), noise(1, (2, 5))
    mass = np.eye(5), 0.2 * np.diag(abs(own[0]))
    damping = 0.2 * np.eye(5) + 7e-4 * stiffness, np.diag(np.eye(5)[-1])
    case = Stacks(mass, damping, (stiffness, 300.0 * np.diag(abs(own[1]))), **asked)
    thetas = np.array([0.5, 2.0, 0.3]) + 0.1 * noise(2, (9, 3))
    assert error(case, thetas) < 1e-9
    assert alone == []


def test_full_matrices_and_overdamped_pairs(alone):
    """Masses in oil, coupled by M, C and K: poles that are real next to those that are not."""
    turn = np.linalg.qr(noise(3, (4, 4)))[0]
    stiffness = turn @ np.diag([20.0, 90.0, 300.0, 700.0]) @ turn.T
    oil = turn @ np.diag([20.0, 0.5, 45.0, 1.0]) @ turn.T
    other = 0.1 * np.cov(noise(4, (4, 9)))
    case = Stacks((np.eye(4) + 0.1 * other, other), (oil, other), (stiffness, 10.0 * other))
    assert error(case, 0.5 + 0.2 * noise(7, (3, 3))) < 1e-11
    assert alone == []


def test_through_a_coalescence_of_poles(alone):
    """Two modes that meet: in lanes far from there, alone next to it, 1e-9 everywhere."""
    omega, none = np.array([20.0, 20.4]), np.zeros((2, 2))
    base, pots = 0.02 * np.diag(omega), np.ones((2, 2))
    mass, stiffness = (np.eye(2), np.diag([0.1, 0.0])), (np.diag(omega**2), np.diag([30.0, 0.0]))
    case = Stacks(mass, (base, pots), stiffness)
    steps = np.array([-0.3, -0.1, -1e-2, -1e-5, -1e-9, 0.0, 1e-9, 1e-5, 1e-2])
    thetas = np.stack([none[0, 0] + 0.0 * steps, meeting(omega, base, pots) + steps, 0.0 * steps], axis=1)
    assert error(case, thetas) < 1e-9
    assert 0 < len(alone) < len(thetas)


@pytest.mark.parametrize("ratio", [0.99, 1.0 - 1e-6, 1.0, 1.0 + 1e-6, 1.01])
def test_through_critical_damping(ratio):
    """A pair that becomes two real poles."""
    stiffness = np.diag([400.0, 900.0])
    damping = np.diag([2.0 * ratio * 20.0, 1.0])
    case = Stacks((np.eye(2), np.diag([0.1, 0.0])), (damping, np.ones((2, 2))), (stiffness, np.eye(2)))
    assert error(case, np.zeros((2, 3))) < 1e-9
