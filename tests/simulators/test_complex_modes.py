"""Populations with coupled damping by complex modes: against matrix exponentials, and where they give up."""

import copy
from itertools import product

import numpy as np
import pytest

from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.linear import system
from pymc_features.simulators.numbers.vectors import LANES
from pymc_features.simulators.oscillators.march import GROUP
from support.kernels import (
    linear_misfit,
    linear_misfit_gradient,
    linear_population_discrepancy,
    linear_population_gradient,
    linear_population_misfit,
)
from support.linear import meeting, noise, random_structure, spring_chain
from support.linear_cases import Case

pytestmark = pytest.mark.slow  # they wait for kernels


def dashpots(mass, damping, stiffness, **asked):
    """M, K and C_0 + theta C_1, under the motion of one support unless forces are given."""
    load = {} if "forces" in asked else {"influence": np.ones((len(mass), 1))}
    return Case([mass], damping, [stiffness], [1.0], **load, **asked)


def varied(mass, damping, stiffness, **asked):
    """M_0 + theta_0 M_1, C_0 + theta_1 C_1 and K_0 + theta_2 K_1."""
    none = 0.0 * mass[0]
    terms = [mass[0], mass[1], none, none], [damping[0], none, damping[1], none]
    load = {} if "forces" in asked else {"influence": np.ones((len(none), 1))}
    return Case(*terms, [stiffness[0], none, none, stiffness[1]], np.zeros(3), **load, **asked)


def at(case, theta):
    """The case with another theta."""
    other = copy.copy(case)
    other.theta = np.array(theta)
    return other


def rows(case, thetas):
    """What kernels of populations take."""
    return np.array(thetas), case.rayleigh[None], case.ratios[None], *case.rest


def response_error(case, thetas, quantities=range(4)):
    """Largest root mean square error of a response, of its peak; each structure by itself."""
    worst = 0.0
    for quantity, theta in product(quantities, thetas):
        case.quantity = quantity
        exact = case.reference(np.concatenate([theta, case.rayleigh, case.ratios]))
        e = linear_population_discrepancy(*rows(case, [theta]), exact)
        worst = max(worst, float((np.sqrt(e[0]) / abs(exact).max(axis=1)).max()))
    return worst


def gradient_error(case, thetas, gaps=False):
    """Largest error of a gradient of e_j by one parameter, of the largest of them in the population."""
    exact = []
    weights = noise(6, (len(thetas), 3))
    points = [at(case, theta) for theta in thetas]
    responses = [point.reference(np.concatenate(point.parameters)) for point in points]
    data = noise(5, responses[0].shape)
    if gaps:
        data[1, 20:40] = np.nan
    for point, w, response in zip(points, weights, responses, strict=True):
        misfit = np.nan_to_num(data - response)
        exact.append(-2.0 * (misfit * point.derivatives()[1]).mean(axis=2) @ w)
    found = linear_population_gradient(*rows(case, thetas), data, weights)[0]
    one = linear_misfit_gradient(*points[0].arguments, data, weights[0][:, None])[0]
    np.testing.assert_allclose(one, found[0], rtol=0, atol=1e-12 * abs(found[0]).max())
    return (abs(found - exact) / abs(np.array(exact)).max(axis=0)).max()


@pytest.fixture
def alone(monkeypatch):
    """Structures that were not done in lanes."""
    found, solve = [], system.solve_system
    monkeypatch.setattr(system, "solve_system", lambda a, **more: found.append(a) or solve(a, **more))
    return found


def dashpot_on_chain(n, **asked):
    """A chain of n masses with Rayleigh damping, theta times a dashpot at the top."""
    stiffness = spring_chain(n, 1800.0).toarray()
    damping = [0.2 * np.eye(n) + 7e-4 * stiffness, np.diag(np.eye(n)[-1])]
    return dashpots(np.eye(n), damping, stiffness, **asked)


@pytest.mark.parametrize("n", [1, 2, 5, GROUP // 2 + 3])
def test_dashpot_against_matrix_exponential(n, alone):
    """From none to one that takes half of a wave's energy, all of it in lanes; pairs in two chunks."""
    assert response_error(dashpot_on_chain(n), [[0.0], [0.1], [2.0], [8.0]]) < 1e-9
    assert alone == []


ASKED = {name: {"quantity": q} for q, name in enumerate(QUANTITIES)} | {
    "substeps": {"grid": (3, 1)},
    "stride": {"grid": (1, 4), "n_times": 401},
    "force": {"forces": np.eye(5)[:, [4]], "quantity": 3, "grid": (2, 3)},
}


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_gradients_by_all_matrices(asked, alone):
    """Of a chain with a dashpot at its top, all of it in lanes; data with gaps."""
    stiffness, own = spring_chain(5, 1800.0).toarray(), noise(1, (2, 5))
    mass = np.eye(5), 0.2 * np.diag(abs(own[0]))
    damping = 0.2 * np.eye(5) + 7e-4 * stiffness, np.diag(np.eye(5)[-1])
    case = varied(mass, damping, (stiffness, 300.0 * np.diag(abs(own[1]))), **asked)
    assert gradient_error(case, np.array([0.5, 2.0, 0.3]) + 0.1 * noise(2, (9, 3)), gaps=True) < 1e-9
    assert alone == []


@pytest.mark.parametrize("damping", [1e-3, 0.1, 30.0])
@pytest.mark.parametrize("grid", [(3, 1), (1, 4)])
def test_full_matrices(grid, damping):
    """Full M, C and K, light to over-critical damping; where the modes do not settle, solved alone."""
    mass, pots, stiffness = random_structure(6, 6, damping=damping, rank=3)
    assert response_error(dashpots(mass, [0.0 * pots, pots], stiffness, grid=grid), [[0.5], [1.0]]) < 1e-9


def test_overdamped_pairs_are_two_real_poles(alone):
    """Masses in oil, coupled by M, C and K: poles that are real next to those that are not."""
    turn = np.linalg.qr(noise(3, (4, 4)))[0]
    stiffness = turn @ np.diag([20.0, 90.0, 300.0, 700.0]) @ turn.T
    oil = turn @ np.diag([20.0, 0.5, 45.0, 1.0]) @ turn.T
    other = 0.1 * np.cov(noise(4, (4, 9)))
    case = varied((np.eye(4) + 0.1 * other, other), (oil, other), (stiffness, 10.0 * other))
    thetas = 0.5 + 0.2 * noise(7, (3, 3))
    assert response_error(case, thetas) < 1e-9
    assert gradient_error(case, thetas) < 1e-9
    assert alone == []


@pytest.mark.parametrize("ratio", [0.99, 1.0 - 1e-6, 1.0, 1.0 + 1e-6])
def test_through_critical_damping(ratio):
    """A pair that becomes two real poles."""
    damping = np.diag([2.0 * ratio * 20.0, 1.0]), np.ones((2, 2))
    case = varied((np.eye(2), np.diag([0.1, 0.0])), damping, (np.diag([400.0, 900.0]), np.eye(2)))
    assert gradient_error(case, np.zeros((2, 3))) < 1e-9


def test_through_a_coalescence_of_modes(alone):
    """Two modes that meet: in lanes far from there, alone next to it, 1e-9 everywhere.

    On the way there one small change does not show that they have settled: 1e-12 in lanes.
    """
    omega = np.array([20.0, 20.4])
    base, pots = 0.02 * np.diag(omega), np.ones((2, 2))
    met, mass = meeting(omega, base, pots), (np.eye(2), np.diag([0.1, 0.0]))
    case = varied(mass, (base, pots), (np.diag(omega**2), np.diag([30.0, 0.0])))
    assert response_error(case, [[0.0, met - before, 0.0] for before in (0.3, 0.2, 0.1)]) < 1e-12
    assert alone == []
    steps = np.array([-0.3, -1e-2, -1e-5, -1e-9, 0.0, 1e-9, 1e-5, 1e-2])
    thetas = np.stack([0.0 * steps, met + steps, 0.0 * steps], axis=1)
    assert response_error(case, thetas) < 1e-9
    assert 0 < len(alone) < 4 * steps.size
    alone.clear()
    assert gradient_error(case, thetas) < 1e-9
    assert 0 < len(alone) < steps.size


def test_neighbours_do_not_matter():
    """Particles with coalescing modes, none, and no structure beside ordinary ones: each as it is alone."""
    case = dashpot_on_chain(4)
    thetas = np.array([0.1, 1.0, 500.0, np.nan, 2.0, -3.0, 0.0, np.inf, 30.0, 0.7, 1.5])[:, None]
    data = noise(3, (3, 120))
    together = linear_population_misfit(*rows(case, thetas), data)
    for theta, found in zip(thetas, together, strict=True):
        np.testing.assert_array_equal(linear_population_misfit(*rows(case, [theta]), data)[0], found)
        slow = linear_misfit(*at(case, theta).arguments, data)
        np.testing.assert_allclose(found, slow, rtol=1e-9, atol=1e-10)
    assert np.isnan(together).all(axis=(1, 2)).tolist() == [bool(not t >= 0 or np.isinf(t)) for t in thetas]


@pytest.mark.parametrize("n_modes", [1, 3, 5])
def test_modes_left_out_and_gaps(n_modes):
    """The lowest modes, coupled among themselves, and data with gaps, as one particle has them."""
    case, data = dashpot_on_chain(6, n_modes=n_modes), noise(4, (3, 120))
    data[2, 30:50] = np.nan
    thetas = np.linspace(0.1, 3.0, LANES + 1)[:, None]
    for quantity in range(4):
        case.quantity = quantity
        found = linear_population_discrepancy(*rows(case, thetas), data)
        slow = [linear_misfit(*at(case, theta).arguments, data)[:, 0] for theta in thetas]
        np.testing.assert_allclose(found, slow, rtol=1e-9)


def test_a_force_on_a_floating_chain():
    """A rigid-body mode held by dashpots, under a force; gyroscopic ones go the slow way."""
    stiffness = spring_chain(4, 200.0, free=True).toarray()
    pots = [np.diag([0.0, 0.5, 0.0, 0.2]), np.diag([0.1, 0.0, 0.0, 0.0])]
    case = dashpots(np.eye(4), pots, stiffness, forces=np.eye(4)[:, [3]])
    assert response_error(case, [[0.0], [1.0]]) < 1e-9
    skew = np.zeros((4, 4))
    skew[0, 1], skew[1, 0] = 0.3, -0.3
    case = dashpots(np.eye(4), [pots[0] + skew, pots[1]], stiffness + np.eye(4))
    assert response_error(case, [[1.0]], [0]) < 1e-9


@pytest.mark.parametrize("share", [0.1, -0.1])
def test_constant_damping(share, alone):
    """The same C for all particles: in lanes, and no response where it feeds energy."""
    case = dashpots(np.eye(3), [np.diag([0.3, share, 0.2])], spring_chain(3, 40.0).toarray())
    found = linear_population_discrepancy(*rows(case, np.zeros((2, 0))), np.ones((3, 120)))
    assert np.isfinite(found).all(axis=1).tolist() == [share > 0.0] * 2
    assert (alone == []) == (share > 0.0)
