"""Long records: mean squares and gradients from tables are those of the march, in public comparisons."""

import pickle

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph
from scipy import sparse

from pymc_features import (
    AffineStructure,
    CorrelatedNormal,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    TruncNormalFeature,
    mean_square_discrepancy,
    records,
    response,
    simulate,
)
from pymc_features.ops import long_records
from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.long_records import misfits
from pymc_features.smc.density.evaluation import population_logp
from support.graphs import PLAIN
from support.reference import first_order_hold
from support.straight import Loading, Record

N_TIMES, DT, PARTICLES = 2003, 0.02, 11  # the same whatever the width of a vector
LIGHT = RayleighDamping(0.2, 1e-3)
SENSORS = [3, 0, 1]
SPRINGS = np.random.default_rng(2).uniform(0.7, 1.4, (PARTICLES, 4))


@pytest.fixture(autouse=True)
def tables_of_short_records(monkeypatch):
    """Have tables of records that are shorter than those which a run would wait for."""
    monkeypatch.setattr(long_records, "FEWEST_STEPS", N_TIMES)


def noise(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def chain(x, damping=LIGHT):
    """Frequencies of 7 to 38 rad/s; the sampling's Nyquist frequency is 157."""
    return SpringMassChain(np.ones(4), 400.0 * x, damping)


def dense(x, damping=LIGHT, as_stored=np.asarray):
    """As matrices, whose first two springs vary."""
    drifts = np.eye(4) - np.eye(4, k=-1)
    springs = [as_stored(400.0 * np.outer(drift, drift)) for drift in drifts]
    mass, stiffness = as_stored(np.eye(4)), springs[2] + springs[3]
    return AffineStructure(
        mass, stiffness=stiffness, damping=damping, stiffness_terms=springs[:2], theta=x[:2]
    )


FROM_REST = Record(np.append(0.0, noise(N_TIMES - 1, 6)), DT)  # no function more
BAND_LIMITED = records.Record(noise(N_TIMES, 8), DT)
ASKED = {  # outputs at each step or fewer; own values of the record beside those marched
    "all": {},
    "modes": {"record": FROM_REST, "n_modes": 3},
    "fine": {"dt": DT / 2},
    "coarse": {"dt": 3 * DT, "record": Record(noise(3 * N_TIMES), DT)},
    "refined": {"record": BAND_LIMITED},
    "finer": {"record": records.Record(noise(N_TIMES, 9), DT), "n_modes": 3, "dt": DT / 2},
}


class Case:
    """Mean squares (p, s) of a population, and the gradient of their sum, by a table and by the march."""

    def __init__(self, build=chain, record=None, part=0.3, observed=None, **asked):
        self.record = Record(noise(N_TIMES), DT) if record is None else record
        asked = {"sensors": SENSORS} | asked
        true = np.asarray(simulate(build(np.ones(4)), self.record, **asked))
        self.observed = true + part * np.sqrt((true**2).mean(axis=1))[:, None] * noise(true.shape, 1)
        self.observed = self.observed if observed is None else observed(self.observed)
        x, rows, data = pt.tensor(shape=(4,), dtype="float64"), pt.dmatrix(), pt.dmatrix()
        e = mean_square_discrepancy(response(build(x), self.record, **asked), data)
        many = vectorize_graph(e, {x: rows})
        self.weights = noise((1, true.shape[0]), 3)
        outputs = [many, pt.grad((self.weights * many).sum(), rows)]
        self.function = pytensor.function([rows, data], outputs, mode=PLAIN)

    def by_table(self, rows=SPRINGS):
        return self.function(rows, self.observed)

    def marched(self, rows=SPRINGS):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(long_records, "FEWEST_STEPS", 10**9)
            patch.setattr(long_records, "FEWEST_ALONE", 10**9)
            return self.function(rows, self.observed)

    def tables(self):
        """Tables of the compiled function."""
        tags = [node.tag for node in self.function.maker.fgraph.apply_nodes]
        return [tag.tables.table for tag in tags if hasattr(tag, "tables") and tag.tables.table]


def check(case, rows=SPRINGS, slope=1e-10):
    """Both are the same, and not by the same road, whose last digits would be the same."""
    (e, gradient), (expected, expected_gradient) = case.by_table(rows), case.marched(rows)
    np.testing.assert_allclose(e, expected, rtol=1e-9)
    scale = abs(expected_gradient).max()
    np.testing.assert_allclose(gradient, expected_gradient, rtol=0.0, atol=slope * scale)
    assert (e != expected).any() and (gradient != expected_gradient).any()


def check_marched(case, rows=SPRINGS, outputs=(0, 1)):
    """The table does nothing."""
    found, expected = case.by_table(rows), case.marched(rows)
    for i in outputs:
        np.testing.assert_array_equal(found[i], expected[i])


def test_matrix_exponential():
    """Two particles against their state space, with an excitation that does not begin with zero."""
    case = Case()
    found, _ = case.by_table(SPRINGS[:2])
    for p in range(2):
        _, damping, stiffness = chain(SPRINGS[p]).matrices()
        x, v, _ = first_order_hold(damping, stiffness, -np.ones((4, 1)), case.record.acceleration[None], DT)
        absolute = -(damping @ v + stiffness @ x)[SENSORS]
        np.testing.assert_allclose(found[p], ((case.observed - absolute) ** 2).mean(axis=1), rtol=1e-10)
    assert (found != case.marched(SPRINGS[:2])[0]).any()


@pytest.mark.parametrize("build", [chain, dense])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_agrees_with_the_march(build, quantity):
    for asked in ASKED.values():
        check(Case(build, quantity=quantity, **asked))


@pytest.mark.parametrize("ratio", [0.0005, 0.3])
def test_light_and_strong_damping(ratio):
    """Poles on other levels of the nodes, of samples that are eight times as dense."""
    check(Case(lambda x: chain(x, ModalDamping(ratio)), dt=DT / 8), slope=1e-9)


def test_many_sensors():
    """More functions than a vector has lanes."""
    check(Case(sensors=[i % 4 for i in range(11)]))


def with_gap(data):
    data[1, 50:60] = np.nan
    return data


FORCES = Loading(noise((2, N_TIMES)), DT, kind="force", matrix=noise((4, 2), 7))
NO_TABLE = {
    "no damping": {"build": lambda x: chain(x, ModalDamping(0.0))},
    "critical and strong damping": {"build": lambda x: chain(x, ModalDamping([1.0, 4.0, 1.0, 4.0]))},
    "some modes near critical": {"build": lambda x: chain(x, ModalDamping([0.02, 0.995, 0.05, 1.2]))},
    "gaps": {"observed": with_gap},
    "coarse outputs": {
        "record": Record(noise(20 * N_TIMES), DT),
        "dt": 2 * long_records.MOST_STRIDE * DT,
    },
    "a short record": {"record": Record(noise(1500), DT)},
}


@pytest.mark.parametrize("asked", NO_TABLE.values(), ids=NO_TABLE)
def test_what_a_table_cannot_do_is_marched(asked):
    check_marched(Case(**asked))


def test_several_inputs_and_coupled_modes_are_marched():
    check_marched(Case(dense, record=FORCES, quantity="relative_acceleration"))
    check_marched(Case(lambda x: dense(x, np.diag([5.0, 0.3, 0.3, 0.3]))))


def test_sparse_structures_have_values_only():
    case = Case(lambda x: dense(x, as_stored=sparse.csc_array))
    (e, gradient), (expected, marched) = case.by_table(), case.marched()
    np.testing.assert_allclose(e, expected, rtol=1e-9)
    assert (e != expected).any()
    np.testing.assert_array_equal(gradient, marched)


def test_cancellation_is_estimated(monkeypatch):
    """e_j of 1e-14 of the data's squares is lost in rounding: marched, particle by particle."""
    case, rows = Case(part=1e-7), SPRINGS.copy()
    rows[0] = 1.0
    (found, _), (expected, _) = case.by_table(rows), case.marched(rows)
    np.testing.assert_array_equal(found[0], expected[0])
    assert (found[1:] != expected[1:]).any()
    monkeypatch.setattr(misfits, "ROUNDING", 0.0)  # without the estimate
    assert not np.allclose(case.by_table(rows)[0][0], expected[0], rtol=1e-6, atol=0.0)


def test_close_modes_are_marched():
    """Two masses that do not know of each other, the same but for 1e-7 in one particle."""

    def build(x):
        terms = [np.diag([0.0, 1.0])]
        return AffineStructure(
            np.eye(2), stiffness=100.0 * np.eye(2), damping=LIGHT, stiffness_terms=terms, theta=30.0 * x[:1]
        )

    case, rows = Case(build, sensors=[0, 1]), SPRINGS.copy()
    rows[2] = 1e-6
    (_, found), (_, expected) = case.by_table(rows), case.marched(rows)
    np.testing.assert_array_equal(found[2], expected[2])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * abs(expected).max())
    assert (found != expected).any()


def test_particles_that_are_no_structures():
    case, rows = Case(), SPRINGS.copy()
    rows[1, 2], rows[4] = -1.0, np.nan
    for found, expected in zip(case.by_table(rows), case.marched(rows), strict=True):
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(found).all(axis=1)), [1, 4])
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * np.nanmax(abs(expected)))


def test_same_bits_in_any_order_and_company(monkeypatch):
    """Of one function and of another, and where less memory is allowed than all need together."""
    together = Case().by_table()
    order = np.random.default_rng(3).permutation(PARTICLES)
    for most in (misfits.MOST_BYTES, 5e5):
        monkeypatch.setattr(misfits, "MOST_BYTES", most)
        case = Case()
        for which in (order[:1], order[:3], order[3:], order[:1]):
            for found, whole in zip(case.by_table(SPRINGS[which]), together, strict=True):
                np.testing.assert_array_equal(found, whole[which])
        assert all(own.mesh.values.nbytes <= most for own in case.tables())

    monkeypatch.setattr(misfits, "MOST_BYTES", 1e4)
    check_marched(Case())  # too little for a table


def test_changed_data_get_another_table():
    """Changed in place, by one number."""
    case = Case()
    before, _ = case.by_table()
    case.observed[1, 7] += 40.0
    check(case)
    assert (abs(case.by_table()[0] - before)[:, 1] > 0.01 * before[:, 1]).all()


def test_a_wrong_table_is_found_by_the_march():
    case = Case()
    case.by_table()
    assert len(case.tables()) == 2  # of the value and of the gradient
    for own in case.tables():
        own.mesh.values[:] *= 1.0 + 1e-4
        own.checked.clear()
    check_marched(case)
    assert all(own.is_left for own in case.tables())
    check_marched(case)


def test_tables_do_not_travel():
    case = Case()
    before = len(pickle.dumps(case.function))
    case.by_table()
    assert len(pickle.dumps(case.function)) < before + 1e4
    assert sum(own.mesh.values.nbytes for own in case.tables()) > 1e5


def declared(likelihood, record, observed):
    """A model of the first spring."""
    with pm.Model() as model:
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.Uniform("sigma", 0.0, 5.0)
        mu = response(chain(np.ones(4)).scale_stiffness(theta, springs=[0]), record, sensors=SENSORS)
        data = pm.Data("observed", observed) if likelihood == "pm.Data" else observed
        if likelihood is CorrelatedNormal:
            CorrelatedNormal("y", mu, sigma, 0.1, dt=record.dt, observed=data)
        else:
            TruncNormalFeature("y", mu=mu, sigma=sigma, observed=data)
    return model


@pytest.mark.parametrize("likelihood", [TruncNormalFeature, "pm.Data", CorrelatedNormal])
def test_populations_of_a_model(monkeypatch, likelihood):
    """The correlated likelihood marches."""
    observed = np.asarray(simulate(chain(np.ones(4)), BAND_LIMITED, sensors=SENSORS)) + noise((3, N_TIMES), 1)
    model = declared(likelihood, BAND_LIMITED, observed)
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(4).uniform(-1.0, 1.0, (PARTICLES, 2))
    _, found, _, _, slope = logp.gradient(particles)
    monkeypatch.setattr(long_records, "FEWEST_STEPS", 10**9)
    _, expected, _, _, expected_slope = logp.gradient(particles)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-8, atol=1e-10 * abs(expected_slope).max())
    assert (found == expected).all() == (likelihood is CorrelatedNormal)


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", [TruncNormalFeature, "pm.Data"], ids=["constant", "pm.Data"])
def test_one_chain_as_nuts_has_it(monkeypatch, likelihood):
    """Value and gradient in a graph that Numba compiles."""
    record = Record(noise(4003), DT)
    observed = np.asarray(simulate(chain(np.ones(4)), record, sensors=SENSORS)) + noise((3, 4003), 1)
    logp = declared(likelihood, record, observed).logp_dlogp_function(ravel_inputs=True, mode="NUMBA")
    logp.set_extra_values({})
    point = np.array([0.3, -0.2])
    found = [logp(point) for _ in range(2)]
    monkeypatch.setattr(long_records, "FEWEST_ALONE", 10**9)
    value, slope = logp(point)
    for own, gradient in found:
        np.testing.assert_allclose(own, value, rtol=1e-10)
        np.testing.assert_allclose(gradient, slope, rtol=1e-8)
        assert own != value
