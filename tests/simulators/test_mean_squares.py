"""Mean squares from tables: against matrix exponentials, the march, and themselves in another order."""

import gc
import warnings

import numpy as np
import pymc as pm
import pytest
from scipy import sparse

from pymc_features import (
    AffineStructure,
    HystereticChain,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    TruncNormalFeature,
    records,
    response,
)
from pymc_features.ops.population import PopulationDiscrepancy
from pymc_features.simulators import FAMILIES, QUANTITIES, request
from pymc_features.simulators.excitation import excitation_of
from pymc_features.simulators.mean_squares import asked, kept, population, stencil, table
from pymc_features.smc.density.evaluation import population_logp
from support.reference import first_order_hold
from support.straight import Loading, Record

# what the march would put right, and warn of, is a failure here
pytestmark = pytest.mark.filterwarnings("error:.*differ from those of the march")
N_TIMES, DT, PARTICLES = 2003, 0.02, 11  # the same whatever the width of a vector
LIGHT = RayleighDamping(0.2, 1e-3)


FROM_REST = Record(np.append(0.0, np.random.default_rng(6).normal(size=N_TIMES - 1)), DT)  # no function more
BAND_LIMITED = records.Record(np.random.default_rng(8).normal(size=N_TIMES), DT)
ASKED = {  # outputs at each step or fewer; own values of the record beside those marched
    "all": {},
    "modes": {"record": FROM_REST, "n_modes": 3},
    "fine": {"dt": DT / 2},
    "coarse": {"dt": 3 * DT, "n_times": 3 * N_TIMES},
    "refined": {"record": BAND_LIMITED, "factor": 2},
    "finer": {"record": BAND_LIMITED, "factor": 4, "n_modes": 3},
}


@pytest.fixture(autouse=True)
def tables(monkeypatch):
    """No table from before; the calls that took one."""
    monkeypatch.setattr(population, "KEPT", kept.Kept())
    calls, original = [], population.from_tables

    def counted(*arguments):
        calls.append(original(*arguments))
        return calls[-1]

    monkeypatch.setattr(population, "from_tables", counted)
    return calls


def noise(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def chain(damping=LIGHT, n=4):
    """Frequencies of 7 to 38 rad/s, the sampling's Nyquist frequency is 157."""
    return SpringMassChain(np.ones(n), np.full(n, 400.0), damping)


def dense():
    """The same as matrices, the first spring with a factor theta."""
    mass, _, stiffness = chain().matrices()
    term = np.diag([400.0, 0.0, 0.0, 0.0])
    return AffineStructure(mass, stiffness=stiffness, damping=LIGHT, stiffness_terms=[term])


class Case:
    """A population whose stiffness varies, and what is asked of it."""

    def __init__(
        self,
        structure,
        *,
        quantity=0,
        n_modes=None,
        dt=DT,
        factor=1,
        n_times=N_TIMES,
        record=None,
        part=0.3,
        sensors=(3, 0, 1),
    ):
        n = structure.n_dof
        self.family = FAMILIES[structure.family]
        self.record = Record(noise(n_times), DT) if record is None else record
        wanted = request(n, DT, dt=dt, sensors=list(sensors), quantity=QUANTITIES[quantity], n_modes=n_modes)
        wanted = wanted._replace(factor=factor)
        rows = self.family.rows(wanted.sensors, n)
        rows = rows.toarray() if sparse.issparse(rows) else rows
        excitation = excitation_of(structure.excitation(self.record), self.record, wanted)
        inputs = self.family.inputs_of(structure, self.record, excitation, rows, n_modes or n)
        base = self.family.assemble(inputs, quantity)
        true = self.family.kernels["response"](*base)
        self.observed = true + part * np.sqrt((true**2).mean(axis=1))[:, None] * noise(true.shape, 1)
        varied, factor = ("theta", 0.3) if structure.family == "linear" else ("stiffness", 1.0)
        names = self.family.parameters
        rows = {name: np.array(getattr(base[0], name), dtype=float)[None] for name in names}
        rows[varied] = rows[varied] * factor * np.random.default_rng(2).uniform(0.7, 1.4, (PARTICLES, 1))
        self.arguments = base[0]._replace(**rows), *base[1:]

    def of(self, which):
        """The arguments of some particles."""
        parameters = self.arguments[0]
        own = {name: getattr(parameters, name) for name in self.family.parameters}
        own = {name: x[which] if len(x) > 1 else x for name, x in own.items()}
        return parameters._replace(**own), *self.arguments[1:]

    def by_table(self, which=slice(None)):
        return population.mean_squares(self.family, self.of(which), self.observed)

    def marched(self, which=slice(None)):
        return self.family.kernels["population_discrepancy"](*self.of(which), self.observed)


def test_stencil_is_as_exact_as_it_says():
    """Random points of the square, and of the time axis beyond those it was fitted to."""
    rng, points = np.random.default_rng(0), np.arange(-stencil.REACH, stencil.REACH + 1)
    nu = rng.uniform(-0.5, 0.5, 300) + 1j * rng.uniform(-0.5, 0.5, 300)
    theta = np.pi / 3.0 * rng.uniform(-1.0, 1.0, 300)
    even, odd = stencil.coefficients()
    powers = nu[:, None] ** (2 * np.arange(stencil.TERMS))
    halves = powers @ even.T, nu[:, None] * (powers @ odd.T)
    weights = np.concatenate([(halves[0] - halves[1])[:, :0:-1], halves[0] + halves[1]], axis=1)
    found = weights @ (np.exp(1j * np.outer(points, theta)) / stencil.window(theta))
    np.testing.assert_allclose(found, np.exp(1j * np.outer(nu, theta)), atol=3e-14)


def test_matrix_exponential(tables):
    """Two particles against their state space, with an excitation that does not begin with zero."""
    case = Case(chain())
    found = case.by_table(slice(2))
    springs = case.arguments[0].stiffness
    for p in range(2):
        whole = SpringMassChain(np.ones(4), springs[p], LIGHT)
        _, damping, stiffness = whole.matrices()
        x, v, _ = first_order_hold(damping, stiffness, -np.ones((4, 1)), case.record.acceleration[None], DT)
        absolute = -(damping @ v + stiffness @ x)[[3, 0, 1]]
        np.testing.assert_allclose(found[p], ((case.observed - absolute) ** 2).mean(axis=1), rtol=1e-10)
    assert tables[0][1].all()  # none of them marched


@pytest.mark.parametrize("structure", [chain(), dense()], ids=["chain", "linear"])
@pytest.mark.parametrize("quantity", range(4), ids=QUANTITIES)
@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_agrees_with_the_march(tables, structure, quantity, asked):
    case = Case(structure, quantity=quantity, **asked)
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    assert tables[0][1].all()


@pytest.mark.parametrize("factor", [1, 2], ids=["lines", "refined"])
@pytest.mark.parametrize("from_rest", [False, True])
def test_several_inputs(tables, from_rest, factor):
    """Two forces, so that modes have two inputs in different parts."""
    values, kind = noise((2, N_TIMES)), Loading if factor == 1 else records.Loading
    values[:, 0] *= not from_rest
    forces = kind(values, DT, kind="force", matrix=noise((4, 2), 7))
    case = Case(dense(), record=forces, quantity=1, factor=factor)
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    assert tables[0][1].all()


@pytest.mark.parametrize(
    "damping", [ModalDamping(0.3), ModalDamping([0.02, 0.2, 0.6, 1.2])], ids=["heavy", "over"]
)
def test_strong_damping(tables, damping):
    """Poles on the other levels of the mesh, and two real ones."""
    case = Case(chain(damping), dt=DT / 8)
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    assert tables[0][1].all()


@pytest.mark.parametrize("quantity", range(4), ids=QUANTITIES)
@pytest.mark.parametrize(
    "asked", [ASKED["all"], ASKED["modes"], ASKED["refined"]], ids=["", "modes", "refined"]
)
def test_complex_modes(tables, quantity, asked):
    """A dashpot at the base couples the modes; one particle is no structure."""
    mass, damping, stiffness = chain().matrices()
    damping[0, 0] += 5.0
    terms = [np.diag([400.0, 0.0, 0.0, 0.0])]
    case = Case(
        AffineStructure(mass, stiffness=stiffness, damping=damping, stiffness_terms=terms),
        quantity=quantity,
        **asked,
    )
    case.arguments[0].theta[2] = np.nan
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    assert np.flatnonzero(~tables[0][1]).tolist() == [2]


def test_strong_dashpots_are_marched(tables):
    """Their complex modes do not come out, or not surely."""
    mass, damping, stiffness = chain().matrices()
    damping[0, 0] += 500.0
    terms = [np.diag([400.0, 0.0, 0.0, 0.0])]
    case = Case(AffineStructure(mass, stiffness=stiffness, damping=damping, stiffness_terms=terms))
    np.testing.assert_array_equal(case.by_table(), case.marched())
    assert not tables[0][1].any()


@pytest.mark.parametrize("damping", [ModalDamping(0.0), ModalDamping(1.0), ModalDamping(4.0)], ids=str)
def test_what_a_table_cannot_do_is_marched(tables, damping):
    """Without damping, critically damped, and poles that last less than a hundred samples."""
    case = Case(chain(damping))
    np.testing.assert_array_equal(case.by_table(), case.marched())
    assert not tables[0][1].any()


def test_cancellation_is_estimated(tables, monkeypatch):
    """e_j of 1e-14 of g'g is lost in rounding: marched, particle by particle."""
    case = Case(chain(), part=1e-7)
    case.arguments[0].stiffness[0] = 400.0
    found = case.by_table()
    np.testing.assert_array_equal(found[0], case.marched()[0])
    is_sure = tables[0][1]
    assert not is_sure[0] and is_sure[1:].all()
    monkeypatch.setattr(population, "ROUNDING", 0.0)  # without the estimate
    assert not np.allclose(case.by_table()[0], found[0], rtol=1e-6, atol=0.0)


def test_same_bits_in_any_order_and_company(monkeypatch):
    case = Case(chain())
    together = case.by_table()
    order = np.random.default_rng(3).permutation(PARTICLES)
    for which in (order, order[:3], order[:1]):
        np.testing.assert_array_equal(case.by_table(which), together[which])
        monkeypatch.setattr(population, "KEPT", kept.Kept())  # another process, which begins with these
        np.testing.assert_array_equal(case.by_table(which), together[which])
    monkeypatch.setattr(table, "MOST_BYTES", 5e5)  # less than all need: filled and dropped in turn
    monkeypatch.setattr(asked, "MOST_BYTES", 5e5)
    monkeypatch.setattr(population, "KEPT", kept.Kept())
    np.testing.assert_array_equal(case.by_table(), together)
    [data] = population.KEPT.by_content.values()
    assert data.table(False).mesh.values.nbytes <= 5e5


def test_invalid_rows_are_nan():
    case = Case(chain())
    case.arguments[0].stiffness[1] = -1.0
    case.arguments[0].stiffness[4] = np.nan
    expected = case.marched()
    assert np.isnan(expected[[1, 4]]).all()
    np.testing.assert_allclose(case.by_table(), expected, rtol=1e-9)


def test_data_with_gaps_are_marched(tables):
    case = Case(chain())
    case.observed[1, 50:60] = np.nan
    np.testing.assert_array_equal(case.by_table(), case.marched())
    assert tables == []


def test_changed_data_get_another_table():
    """Changed in place where nobody looks, and in all values; the memory of what is gone is not mistaken."""
    case = Case(chain())
    case.by_table()
    case.observed[1] += 1.0
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    case.observed[1, 7] += 40.0  # found when all are compared
    [*_, (_, _, data)] = population.KEPT.by_memory.values()
    data.until_check.clear()
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)
    owners = next(iter(population.KEPT.by_memory.values()))[0]
    case.observed = case.observed.copy()
    gc.collect()
    assert owners[0]() is None
    np.testing.assert_allclose(case.by_table(), case.marched(), rtol=1e-9)


def test_few_tables_are_kept():
    case = Case(chain())
    for shift in range(kept.MOST_TABLES + 2):
        case.observed = case.observed + shift
        case.by_table(slice(1))
    assert len(population.KEPT.by_content) == kept.MOST_TABLES
    assert len(population.KEPT.by_memory) <= kept.MOST_TABLES


def test_a_wrong_table_is_found_by_the_march(tables):
    case = Case(chain())
    case.by_table()
    [data] = population.KEPT.by_content.values()
    data.table(False).mesh.values[:] *= 1.0 + 1e-4
    data.until_check.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # decided here, and nothing that a user could do
        found = case.by_table()
    np.testing.assert_array_equal(found, case.marched())
    count = len(tables)
    np.testing.assert_array_equal(case.by_table(), case.marched())
    assert len(tables) == count  # not asked any more


def test_each_particle_counts_towards_the_next_check():
    """One vector of particles is marched for each N evaluated, and at once where the table has grown."""
    case = Case(chain())
    case.by_table()
    [data] = population.KEPT.by_content.values()
    assert data.until_check["population_discrepancy"] == N_TIMES - PARTICLES
    case.by_table()
    assert data.until_check["population_discrepancy"] == N_TIMES - 2 * PARTICLES
    case.arguments[0].stiffness[0] *= 3.0
    case.by_table()
    assert data.until_check["population_discrepancy"] == N_TIMES - PARTICLES


@pytest.mark.parametrize("as_data", [False, True], ids=["constant", "pm.Data"])
def test_likelihoods_of_long_records(tables, monkeypatch, as_data):
    case = Case(chain(), record=BAND_LIMITED)
    with pm.Model() as model:
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.Uniform("sigma", 0.0, 5.0)
        mu = response(chain().scale_stiffness(theta, springs=[0]), case.record, sensors=[3, 0, 1])
        observed = pm.Data("observed", case.observed) if as_data else case.observed
        TruncNormalFeature("y", mu=mu, sigma=sigma, observed=observed)
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(4).uniform(-1.0, 1.0, (PARTICLES, 2))
    _, found, _ = logp(particles)
    assert len(tables) > 0
    monkeypatch.setattr(population, "FEWEST_STEPS", 5 * N_TIMES)
    count = len(tables)
    _, expected, _ = logp(particles)
    assert len(tables) == count
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6)


def test_short_records_and_yielding_springs_are_marched(tables):
    """And outputs much coarser than the record."""
    short = Case(chain(), n_times=population.FEWEST_STEPS - 1)
    coarse = Case(chain(), dt=2 * population.MOST_STRIDE * DT)
    for case in (short, coarse):
        op = PopulationDiscrepancy()
        parameters, excitation, wanted = case.arguments
        inputs = [*parameters, *excitation, wanted.sensors, wanted.n_modes, case.observed]
        [found] = op.run([np.asarray(x) for x in inputs])
        np.testing.assert_array_equal(found, case.marched())
    assert tables == []
    assert "population_systems" not in FAMILIES[HystereticChain.family].kernels


@pytest.mark.parametrize("quantity", [0, 3])
def test_forces_and_particles_that_are_no_structures(quantity):
    """Masses are pushed by other forces than their inertia; three particles have no modes."""
    case = Case(dense(), quantity=quantity)
    parameters = case.arguments[0]
    theta = parameters.theta.copy()
    theta[1], theta[3], theta[5] = np.nan, -50.0, -1e300
    forces = np.random.default_rng(5).normal(size=parameters.forces.shape)
    before = case.by_table()
    case.arguments = parameters._replace(theta=theta, forces=forces), *case.arguments[1:]
    found = case.by_table()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found).all(axis=1)), [1, 3, 5])
    np.testing.assert_allclose(found, case.marched(), rtol=1e-9)
    assert not np.isclose(found[0], before[0], rtol=1e-3).any()
