"""Hamiltonian trajectories in the chains of `PersistentSMC`: what they leave invariant, and when they run."""

from functools import cache

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from scipy import stats

from pymc_features import DiscrepancySimulator, PersistentSMC, sample
from pymc_features.exceptions import NotDifferentiableError
from pymc_features.smc.kernels import chains
from pymc_features.smc.kernels.chains import ARMS, HAMILTONIAN, Chains, FittedMoves, Hamiltonian
from pymc_features.smc.proposals.pool import Pool
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT
from pymc_features.smc.proposals.reference import Mode, Reference
from support.reference import richardson
from support.sampling import mean_within_errors, run_chain


class Gaussian:
    """Correlated, four parameters of different scale."""

    factor = np.diag([1.0, 3.0, 0.1, 1.0]) @ np.linalg.cholesky(0.8 + 0.2 * np.eye(4))

    def draw(self, n, rng):
        return 1.0 + rng.standard_normal((n, 4)) @ self.factor.T

    def logp(self, x):
        return -0.5 * (self.normal(x) ** 2).sum(axis=1)

    def gradient(self, x):
        return -np.linalg.solve(self.factor.T, self.normal(x).T).T

    def normal(self, x):
        """Independent standard normal numbers of the points."""
        return np.linalg.solve(self.factor, (x - 1.0).T).T


class Bent:
    """Skewed: the first parameter is ln of a gamma variable, the second normal around its square."""

    shape = 3.0

    def draw(self, n, rng):
        u = np.log(rng.gamma(self.shape, size=n))
        return np.column_stack([u, u**2 + 0.5 * rng.standard_normal(n)])

    def logp(self, x):
        u, v = x.T
        return self.shape * u - np.exp(u) - 2.0 * (v - u**2) ** 2

    def gradient(self, x):
        u, v = x.T
        return np.column_stack([self.shape - np.exp(u) + 8.0 * u * (v - u**2), -4.0 * (v - u**2)])

    def normal(self, x):
        u, v = x.T
        return np.column_stack([stats.norm.ppf(stats.gamma(self.shape).cdf(np.exp(u))), 2.0 * (v - u**2)])


TARGETS = [Gaussian(), Bent()]


def named(target):
    return type(target).__name__


def assert_gradient(log_density, gradient, x):
    """Against differences of the log-density at points (n, d)."""
    for direction, column in zip(np.eye(x.shape[1]), gradient(x).T, strict=True):
        np.testing.assert_allclose(column, richardson(log_density, x, direction), rtol=1e-6, atol=1e-7)


def test_gradient_of_a_reference():
    """Of a mixture of Student-t distributions, and of that with the prior; far out as well."""
    rng = np.random.default_rng(1)
    factors = [np.linalg.cholesky(np.cov(rng.standard_normal((3, 9)))) for _ in range(2)]
    mixture = StudentMixture(
        [StudentT(rng.standard_normal(3), f, v) for f, v in zip(factors, (3.0, 60.0), strict=True)],
        np.array([0.3, 0.7]),
    )
    x = rng.standard_normal((4, 3)) * [[0.1], [1.0], [3.0], [30.0]]
    assert_gradient(mixture.log_density, mixture.gradient, x)
    modes = [Mode(rng.standard_normal(3), f, e, 1) for f, e in zip(factors, (0.0, -1.0), strict=True)]
    reference = Reference(modes, np.zeros(3), np.array([1.0, 2.0, 0.5]))

    def log_prior(x):
        return -0.5 * (x**2).sum(axis=1) - 1.5 * np.log(2.0 * np.pi)

    assert_gradient(
        lambda x: reference.log_density(x, log_prior(x)), lambda x: reference.gradient(x, log_prior(x), -x), x
    )


STEPS, CHAINS = 24, 2000
FALSE_ALARM = 1e-3


def by_trajectories(target, seed=0, hamiltonian=None, wrong=1.0):
    """Chains that begin at exact draws and follow trajectories alone.

    The first component of the gradient is multiplied by `wrong`. Step and length adapt in the burn-in.
    """
    rng = np.random.default_rng(seed)
    x = target.draw(CHAINS, rng)

    def slopes(x):
        gradient = target.gradient(x)
        gradient[:, 0] *= wrong
        return np.zeros(len(x)), target.logp(x), np.zeros_like(x), gradient

    pool = Pool(x, np.zeros(CHAINS), target.logp(x))
    pool.add_density(1.0, 0.0)
    moves = FittedMoves()
    moves.hamiltonian = hamiltonian or Hamiltonian()
    moves.fit(target.draw(500, rng), rng)
    moves.shares = np.eye(len(ARMS))[HAMILTONIAN]
    chains = Chains(pool, np.arange(CHAINS), moves, 1.0, lambda x: slopes(x)[:2], rng, slopes)
    moves.adapt = lambda share: None
    chains.forget()
    learned = moves.hamiltonian.step, moves.hamiltonian.length
    for _ in range(STEPS):
        chains.step()
    assert learned == (moves.hamiltonian.step, moves.hamiltonian.length), "frozen while states are kept"
    return chains


def smallest_probability(target, chains):
    """Kolmogorov-Smirnov of each exact normal number of the chains' last states, Bonferroni's way."""
    z = target.normal(chains.x)
    return min(stats.kstest(column, "norm").pvalue for column in z.T) * z.shape[1]


@pytest.mark.statistical
@pytest.mark.parametrize("target", TARGETS, ids=named)
def test_trajectories_leave_the_target_invariant(target):
    """Of the last states; a false alarm in 1000. Proposals, with their probabilities, have its quantiles.

    These are compared group by group of chains, of a Student t with 19 degrees of freedom: a false alarm in
    1300 for each of nine quantiles at most.
    """
    chains = by_trajectories(target)
    assert smallest_probability(target, chains) > FALSE_ALARM
    assert 0.6 < np.mean(chains.acceptances[-STEPS:]) < 0.85, "the step size is adapted"
    pool, rows = chains.pool, slice(chains.first, None)
    z, visits, groups = target.normal(pool.particles[rows]), pool.visits[rows], pool.group[rows] % 20
    assert visits.sum() == pytest.approx(CHAINS * STEPS)
    for column in z.T:
        for p in (0.05, 0.5, 0.95):
            below = visits * ((column < stats.norm.ppf(p)) - p)
            assert mean_within_errors([below[groups == g].sum() for g in range(20)])


@pytest.mark.statistical
@pytest.mark.parametrize("target", TARGETS, ids=named)
def test_a_wrong_gradient_only_lowers_the_acceptance(target):
    """Off in one coordinate, with the same steps; a false alarm in 1000."""
    right = by_trajectories(target)
    hamiltonian = Hamiltonian()
    hamiltonian.learn = lambda *_: None
    hamiltonian.step, hamiltonian.length = right.moves.hamiltonian.step, right.moves.hamiltonian.length
    found = by_trajectories(target, hamiltonian=hamiltonian, wrong=1.5)
    assert smallest_probability(target, found) > FALSE_ALARM
    assert np.mean(right.acceptances[-STEPS:]) - np.mean(found.acceptances[-STEPS:]) > 0.03


class WithoutKinetic(Hamiltonian):
    """Accepts by the density at both ends, as if trajectories were a symmetric walk."""

    def propose(self, *arguments):
        end = super().propose(*arguments)
        return end._replace(log_moves=np.where(np.isneginf(end.log_moves), -np.inf, 0.0))


@pytest.mark.statistical
@pytest.mark.parametrize("target", TARGETS, ids=named)
def test_a_wrong_acceptance_is_found(target):
    chains = by_trajectories(target, hamiltonian=WithoutKinetic())
    assert smallest_probability(target, chains) < 1e-2 * FALSE_ALARM


@cache
def ring():
    """A thin shell around the origin, in three dimensions."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=3)
        pm.Potential("shell", -5.0 * (pt.sum(x**2) - 2.0) ** 2)
    return model


def exact_of_ring():
    """Log evidence, and the mean of the squared radius: integrals over the radius."""
    r = np.linspace(1e-3, 6.0, 20001)
    density = stats.chi(3).pdf(r) * np.exp(-5.0 * (r**2 - 2.0) ** 2)
    z = np.trapezoid(density, r)
    return np.log(z), np.trapezoid(r**2 * density, r) / z


@pytest.fixture
def by_gradients(monkeypatch):
    """Half of the steps are trajectories."""
    monkeypatch.setattr(chains, "FIRST_SHARES", (0.1, 0.1, 0.1, 0.1, 0.1, 0.5))
    monkeypatch.setattr(FittedMoves, "adapt", lambda self, share: None)


@pytest.mark.statistical
@pytest.mark.usefixtures("by_gradients")
def test_posterior_and_evidence_of_a_ring():
    """Means over eight seeds within four standard errors, of a Student t: a false alarm in 190 for each."""
    log_z, square = exact_of_ring()
    runs = [run_chain(PersistentSMC, ring(), 400, seed, gradients=True) for seed in range(8)]
    assert mean_within_errors([r.evidence - log_z for r in runs])
    assert mean_within_errors([(r.draws**2).sum(axis=1).mean() - square for r in runs])
    assert mean_within_errors([r.draws[:, 0].mean() for r in runs])
    shares = [max(s["hamiltonian_share"] for s in r.stages) for r in runs]
    assert sum(share > 0.1 for share in shares) >= 6, "others may do without chains: their fits are good"


def linear(x):
    return np.outer(x, [1.0, 2.0])


def test_models_without_gradients():
    """They are refused if gradients are asked for; `sample` does not ask, and says why."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        DiscrepancySimulator("y", linear, x, epsilon=0.3, observed=linear([0.5, -0.5]), kernel="exponential")
    with pytest.raises(NotDifferentiableError, match="no gradient"):
        PersistentSMC(100, model=model, gradients=True)
    idata = sample(100, chains=2, cores=1, model=model, check=None, random_seed=1, progressbar=False)
    assert idata.sample_stats.attrs["no_gradient"]
    assert float(idata.sample_stats["gradients"].sum()) == 0.0
    assert float(idata.sample_stats["hamiltonian_share"].sum()) == 0.0
