"""Populations with coupled damping by complex modes: against matrix exponentials, and where they give up."""

import numpy as np
import pytest

from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.eigen.complex_modes import CANCELLING, check_sums, new_complex
from pymc_features.simulators.linear import response as population
from pymc_features.simulators.oscillators.march import GROUP
from support.kernels import linear_misfit, linear_population_discrepancy, linear_population_misfit
from support.linear import meeting, noise, random_structure, spring_chain
from support.reference import first_order_hold, interpolated

DT, NONE = 0.02, np.zeros(0, dtype=int)


class Dashpots:
    """M, K and C_0 + theta C_1, seen at all degrees of freedom under one support or one force."""

    def __init__(self, mass, damping, stiffness, *, force=None, grid=(1, 1), n_modes=None, n_times=121):
        self.mass, self.damping, self.stiffness = mass, damping, stiffness
        self.n, self.grid = len(mass), grid
        self.influence = np.ones((self.n, 1)) if force is None else np.zeros((self.n, 1))
        self.forces = np.zeros((self.n, 1)) if force is None else force
        self.inputs, self.n_modes = noise(self.n, (1, n_times)), n_modes or self.n

    def arguments(self, theta, quantity):
        stacks = (np.array(a).reshape(-1, self.n**2) for a in ([self.mass], self.damping, [self.stiffness]))
        rest = (
            self.influence,
            self.forces,
            self.inputs,
            DT,
            *self.grid,
            np.eye(self.n),
            self.n_modes,
            quantity,
        )
        return theta, np.zeros((1, 2)), np.zeros((1, self.n)), *stacks, NONE, NONE, *rest

    def exact(self, theta, quantity):
        """The response without modes."""
        load = self.forces - self.mass @ self.influence
        matrices = self.damping[0] + theta * self.damping[1], self.stiffness, load
        system = [np.linalg.solve(self.mass, a) for a in matrices]
        substeps, stride = self.grid
        inputs = interpolated(self.inputs, substeps)
        x, v, a = first_order_hold(*system, inputs, DT / substeps, stride)
        return (a + self.influence @ inputs[:, ::stride], a, v, x)[quantity]

    def worst(self, thetas, quantity):
        """Largest root mean square error, of the peak of each response."""
        worst = 0.0
        for theta in thetas:
            exact = self.exact(theta, quantity)
            e = linear_population_discrepancy(*self.arguments(np.array([[theta]]), quantity), exact)
            worst = max(worst, float((np.sqrt(e[0]) / abs(exact).max(axis=1)).max()))
        return worst


@pytest.fixture
def alone(monkeypatch):
    """Particles that were not done in lanes."""
    found, solve = [], population.solved
    monkeypatch.setattr(population, "solved", lambda a, which: found.extend(which) or solve(a, which))
    return found


def dashpot_on_chain(n):
    """A chain of n masses with Rayleigh damping, theta times a dashpot at the top."""
    stiffness = spring_chain(n, 1800.0).toarray()
    return Dashpots(np.eye(n), [0.2 * np.eye(n) + 7e-4 * stiffness, np.diag(np.eye(n)[-1])], stiffness)


@pytest.mark.parametrize("quantity", range(len(QUANTITIES)), ids=QUANTITIES)
@pytest.mark.parametrize("n", [1, 2, 5, 11])
def test_dashpot_against_matrix_exponential(n, quantity, alone):
    """From none to one that takes half of a wave's energy: 1e-9 of the peak, all of it in lanes."""
    assert dashpot_on_chain(n).worst([0.0, 0.1, 2.0, 8.0], quantity) < 1e-9
    assert alone == []


def test_more_pairs_than_march_together(alone):
    """Pairs of modes in two chunks."""
    assert dashpot_on_chain(GROUP // 2 + 3).worst([0.1, 2.0], 0) < 1e-9
    assert alone == []


@pytest.mark.parametrize("damping", [1e-3, 0.1, 30.0])
@pytest.mark.parametrize(("grid", "n_modes"), [((1, 1), None), ((3, 1), None), ((1, 4), None)])
def test_full_matrices(grid, n_modes, damping):
    """Full M, C and K, light to over-critical damping; where the modes do not settle, solved alone."""
    mass, pots, stiffness = random_structure(6, 6, damping=damping, rank=3)
    case = Dashpots(mass, [0.0 * pots, pots], stiffness, grid=grid, n_modes=n_modes)
    for quantity in range(4):
        assert case.worst([0.5, 1.0], quantity) < 1e-9


def test_overdamped_modes_are_pairs_of_real_ones(alone):
    """Three masses in oil: modes beyond critical damping that hardly couple."""
    stiffness = spring_chain(3, 40.0).toarray()
    oil = 0.7 * stiffness + np.diag([6.0, 6.1, 6.2])
    case = Dashpots(np.eye(3), [oil, np.diag([0.0, 1.0, 0.0])], stiffness)
    for quantity in range(4):
        assert case.worst([0.0, 0.5], quantity) < 1e-9
    assert alone == []


def two_that_meet():
    """Two masses whose complex modes meet, and the theta at which they do."""
    omega = np.array([20.0, 20.4])
    base, both = 0.02 * np.diag(omega), np.ones((2, 2))
    return Dashpots(np.eye(2), [base, both], np.diag(omega**2)), meeting(omega, base, both)


def test_through_a_coalescence_of_modes(alone):
    """Two masses whose complex modes meet: far from there in lanes, next to it alone, 1e-9 everywhere."""
    case, met = two_that_meet()
    thetas = met + np.array([-0.3, -1e-2, -1e-5, -1e-9, 0.0, 1e-9, 1e-5, 1e-2])
    for quantity in range(4):
        assert case.worst(thetas, quantity) < 1e-9
    assert 0 < len(alone) < 4 * thetas.size


@pytest.mark.parametrize("before", [0.3, 0.2, 0.1])
def test_modes_of_which_every_other_change_is_small(before, alone):
    """On the way to a coalescence one small change does not show that they have settled: 1e-12 in lanes."""
    case, met = two_that_meet()
    for quantity in range(4):
        assert case.worst([met - before], quantity) < 1e-12
    assert alone == []


def test_residues_that_are_no_numbers_are_seen():
    """At one of three sensors; lanes whose sums are in order stay."""
    modes = new_complex(1, 3)
    for array in (modes.is_good, modes.omega, modes.participation, modes.seen):
        array.fill(1.0)
    modes.sums[1::3] = modes.sums[2::3] = 1.0
    modes.sums[3:6, 0] = np.nan
    check_sums(modes, 3, CANCELLING)
    np.testing.assert_array_equal(modes.is_good[0], np.arange(LANES) > 0)


def test_neighbours_do_not_matter():
    """Particles with coalescing modes, none, and no structure beside ordinary ones: each as it is alone."""
    n = 4
    case = dashpot_on_chain(n)
    thetas = np.array([0.1, 1.0, 500.0, np.nan, 2.0, -3.0, 0.0, np.inf, 30.0, 0.7, 1.5])[:, None]
    data = noise(3, (n, 121))
    together = linear_population_misfit(*case.arguments(thetas, 0), data)
    for theta, found in zip(thetas, together, strict=True):
        own = case.arguments(theta[None], 0)
        np.testing.assert_array_equal(linear_population_misfit(*own, data)[0], found)
        theta_alone, rayleigh, ratios, *rest = own
        slow = linear_misfit(theta_alone[0], rayleigh[0], ratios[0], *rest, data)
        np.testing.assert_allclose(found, slow, rtol=1e-9, atol=1e-10)
    assert np.isnan(together).all(axis=(1, 2)).tolist() == [bool(not t >= 0 or np.isinf(t)) for t in thetas]


@pytest.mark.parametrize("n_modes", [1, 3, 5])
def test_modes_left_out_and_gaps(n_modes):
    """The lowest modes, coupled among themselves, and data with gaps, as one particle has them."""
    case = dashpot_on_chain(6)
    case.n_modes = n_modes
    data = noise(4, (6, 121))
    data[2, 30:50] = np.nan
    thetas = np.linspace(0.1, 3.0, LANES + 1)[:, None]
    for quantity in range(4):
        found = linear_population_discrepancy(*case.arguments(thetas, quantity), data)
        for theta, e in zip(thetas, found, strict=True):
            _, rayleigh, ratios, *rest = case.arguments(theta[None], quantity)
            slow = linear_misfit(theta, rayleigh[0], ratios[0], *rest, data)[:, 0]
            np.testing.assert_allclose(e, slow, rtol=1e-9)


def test_a_force_on_a_floating_chain():
    """A rigid-body mode held by dashpots, under a force; massless and gyroscopic ones go the slow way."""
    n = 4
    stiffness = spring_chain(n, 200.0, free=True).toarray()
    pots = [np.diag([0.0, 0.5, 0.0, 0.2]), np.diag([0.1, 0.0, 0.0, 0.0])]
    case = Dashpots(np.eye(n), pots, stiffness, force=np.eye(n)[:, [3]])
    for quantity in range(4):
        assert case.worst([0.0, 1.0], quantity) < 1e-9
    skew = np.zeros((n, n))
    skew[0, 1], skew[1, 0] = 0.3, -0.3
    case = Dashpots(np.eye(n), [pots[0] + skew, pots[1]], stiffness + np.eye(n))
    assert case.worst([1.0], 0) < 1e-9


@pytest.mark.parametrize("share", [0.1, -0.1])
def test_constant_damping(share, alone):
    """The same C for all particles: in lanes, and no response where it feeds energy."""
    case = Dashpots(np.eye(3), [np.diag([0.3, share, 0.2])], spring_chain(3, 40.0).toarray())
    thetas = np.zeros((2, 0))
    found = linear_population_discrepancy(*case.arguments(thetas, 0), np.ones((3, 121)))
    assert np.isfinite(found).all(axis=1).tolist() == [share > 0.0] * 2
    assert (alone == []) == (share > 0.0)
