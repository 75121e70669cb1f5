"""Gradients and statistics of increments from tables: against differences, the march, and a wrong table."""

import warnings

import numpy as np
import pymc as pm
import pytest

from pymc_features import (
    AffineStructure,
    CorrelatedNormal,
    ModalDamping,
    TruncNormalFeature,
    records,
    response,
)
from pymc_features.ops.population import PopulationGradient
from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.mean_squares import kept, population, stencil
from pymc_features.simulators.mean_squares.gradient import population as gradients
from pymc_features.smc.density.evaluation import population_logp
from simulators.test_mean_squares import (
    ASKED,
    BAND_LIMITED,
    DT,
    LIGHT,
    N_TIMES,
    PARTICLES,
    Case,
    chain,
    dense,
    noise,
)
from support.straight import Loading

# what the march would put right, and warn of, is a failure here
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error:.*differ from those of the march")]
CLASSICAL = [chain(), dense()]


def counted(original, calls):
    """The same function, which leaves what is sure in `calls`."""

    def call(*arguments):
        found = original(*arguments)
        calls.append(found[1])
        return found

    return call


@pytest.fixture(autouse=True)
def tables(monkeypatch):
    """No table from before; what was taken from tables, and where it is sure."""
    fresh, calls = kept.Kept(), []
    for module, name in ((population, "from_tables"), (gradients, "sums_over_time")):
        monkeypatch.setattr(module, "KEPT", fresh)

        monkeypatch.setattr(module, name, counted(getattr(module, name), calls))
    return calls


def weights_of(n_statistics, count=PARTICLES):
    return noise((count, 3, n_statistics), 3)


def by_table(case, weights):
    return gradients.misfit_gradient(case.family, case.arguments, case.observed, weights)


def marched(case, weights):
    return case.family.kernels["population_gradient"](*case.arguments, case.observed, weights)


def errors(found, expected):
    """Largest error of each parameter's gradients beside the largest of these."""
    pairs = [(x, y) for x, y in zip(found, expected, strict=True) if y.size and np.abs(y).max() > 0.0]
    return np.array([np.abs(x - y).max() / np.abs(y).max() for x, y in pairs])


def test_slopes_of_the_stencil_are_as_exact_as_it_says():
    rng, points = np.random.default_rng(0), np.arange(-stencil.REACH, stencil.REACH + 1)
    nu = rng.uniform(-0.5, 0.5, 300) + 1j * rng.uniform(-0.5, 0.5, 300)
    theta = np.pi / 3.0 * rng.uniform(-1.0, 1.0, 300)
    even, odd = stencil.coefficients(1)
    powers = nu[:, None] ** (2 * np.arange(stencil.TERMS))
    halves = powers @ even.T, nu[:, None] * (powers @ odd.T)
    weights = np.concatenate([(halves[1] - halves[0])[:, :0:-1], halves[0] + halves[1]], axis=1)
    found = weights @ (np.exp(1j * np.outer(points, theta)) / stencil.window(theta))
    np.testing.assert_allclose(found, 1j * theta * np.exp(1j * np.outer(nu, theta)), atol=3e-14)


@pytest.mark.parametrize("structure", CLASSICAL, ids=["chain", "linear"])
def test_differences_of_the_march(structure):
    """Central differences of all statistics by what varies; one slope wrong by 5 % fails."""
    case, weights = Case(structure), weights_of(4)
    name, factor = ("theta", 0.3) if structure.family == "linear" else ("stiffness", 400.0)
    found = dict(zip(case.family.parameters, by_table(case, weights), strict=True))[name]

    def total(values):
        own = case.arguments[0]._replace(**{name: values})
        kernel = case.family.kernels["population_misfit"]
        return (weights * kernel(own, *case.arguments[1:], case.observed)).sum(axis=(1, 2))

    values = getattr(case.arguments[0], name)
    expected = np.empty_like(found)
    for i in range(values.shape[1]):
        step = np.zeros_like(values)
        step[:, i] = 1e-5 * factor
        expected[:, i] = (total(values + step) - total(values - step)) / (2e-5 * factor)
    assert errors([found], [expected]) < 1e-6
    wrong = found * np.append(1.05, np.ones(found.shape[1] - 1))
    assert errors([wrong], [expected]) > 1e-3


@pytest.mark.parametrize("structure", CLASSICAL, ids=["chain", "linear"])
@pytest.mark.parametrize("n_statistics", [1, 4])
@pytest.mark.parametrize("quantity", range(4), ids=QUANTITIES)
@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_agrees_with_the_march(tables, structure, n_statistics, quantity, asked):
    case, weights = Case(structure, quantity=quantity, **asked), weights_of(n_statistics)
    assert errors(by_table(case, weights), marched(case, weights)).max() < 1e-10
    assert tables[0].all()


@pytest.mark.parametrize("quantity", range(4), ids=QUANTITIES)
@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_statistics_of_increments(tables, quantity, asked):
    case = Case(chain(), quantity=quantity, **asked)
    found = population.misfits(case.family, case.arguments, case.observed, "population_misfit")
    expected = case.family.kernels["population_misfit"](*case.arguments, case.observed)
    np.testing.assert_allclose(found[..., :2], expected[..., :2], rtol=1e-10)
    scale = np.sqrt(expected[..., 0])
    for i in (2, 3):
        assert (abs(found[..., i] - expected[..., i]) < 1e-10 * scale).all()
    assert tables[0].all()


def test_increments_under_several_inputs(tables):
    values = noise((2, N_TIMES))
    case = Case(dense(), record=Loading(values, DT, kind="force", matrix=noise((4, 2), 7)), quantity=1)
    found = population.misfits(case.family, case.arguments, case.observed, "population_misfit")
    expected = case.family.kernels["population_misfit"](*case.arguments, case.observed)
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert tables[0].all()


@pytest.mark.parametrize("n_statistics", [1, 4])
def test_what_is_not_sure_is_marched(tables, n_statistics):
    """Cancellation, a particle that is no structure, close modes, and damping near the critical one."""
    case, weights = Case(chain(), part=1e-7), weights_of(n_statistics)
    case.arguments[0].stiffness[0] = 400.0  # e_j of 1e-14 of g'g
    case.arguments[0].stiffness[3, 1] = -1.0
    found, expected = by_table(case, weights), marched(case, weights)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-4)  # the march itself has few digits there
    assert np.isnan(found[1][3]).all()
    assert not tables[0][[0, 3]].any() and tables[0].sum() == PARTICLES - 2
    over = Case(chain(ModalDamping([0.02, 0.995, 0.05, 1.2])))
    assert errors(by_table(over, weights), marched(over, weights)).max() < 1e-12
    assert not tables[-1].any()


def test_close_modes_are_marched(tables):
    """Two masses that do not know of each other, the same but for 1e-7 in one particle of two."""
    structure = AffineStructure(
        np.eye(2), stiffness=100.0 * np.eye(2), damping=LIGHT, stiffness_terms=[np.diag([0.0, 1.0])]
    )
    case = Case(structure, sensors=[0, 1])
    case.arguments[0].theta[:] = np.linspace(20.0, 40.0, PARTICLES)[:, None]
    case.arguments[0].theta[2] = 1e-5
    weights = noise((PARTICLES, 2, 1), 3)
    found, expected = by_table(case, weights), marched(case, weights)
    assert np.flatnonzero(~tables[0]).tolist() == [2]
    np.testing.assert_array_equal(found[0][2], expected[0][2])
    assert errors(found, expected).max() < 1e-10


def test_several_inputs_and_gaps_are_marched(tables):
    forces = Loading(noise((2, N_TIMES)), DT, kind="force", matrix=noise((4, 2), 7))
    gaps = Case(chain())
    gaps.observed[1, 50:60] = np.nan
    for case in (Case(dense(), record=forces, quantity=1), gaps):
        weights = weights_of(1)
        for own, other in zip(by_table(case, weights), marched(case, weights), strict=True):
            np.testing.assert_array_equal(own, other)
    assert tables == []


def test_a_wrong_table_is_found_by_the_march():
    case, weights = Case(chain()), weights_of(4)
    by_table(case, weights)
    [data] = population.KEPT.by_content.values()
    data.made[True].mesh.values[:] *= 1.0 + 1e-4
    data.until_check.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # decided here, and nothing that a user could do
        found = by_table(case, weights)
    for own, other in zip(found, marched(case, weights), strict=True):
        np.testing.assert_array_equal(own, other)
    assert not data.has_tables


def test_the_op_takes_short_records_by_the_march(tables, monkeypatch):
    """And long ones from a table."""
    case, weights = Case(chain()), weights_of(1)
    parameters, excitation, wanted = case.arguments
    inputs = [*parameters, *excitation, wanted.sensors, wanted.n_modes, case.observed, weights]
    inputs = [np.asarray(x) for x in inputs]
    found = PopulationGradient().run(inputs)
    assert len(tables) > 0
    tables.clear()
    monkeypatch.setattr(gradients, "FEWEST_STEPS", 5 * N_TIMES)
    assert errors(found, PopulationGradient().run(inputs)).max() < 1e-10
    assert tables == []


def declared(case, likelihood, as_data):
    """A model of the first spring."""
    with pm.Model() as model:
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.Uniform("sigma", 0.0, 5.0)
        mu = response(chain().scale_stiffness(theta, springs=[0]), case.record, sensors=[3, 0, 1])
        observed = pm.Data("observed", case.observed) if as_data else case.observed
        if likelihood is CorrelatedNormal:
            CorrelatedNormal("y", mu, sigma, 0.1, dt=DT, observed=observed)
        else:
            likelihood("y", mu=mu, sigma=sigma, observed=observed)
    return model


@pytest.mark.parametrize("likelihood", [TruncNormalFeature, CorrelatedNormal])
def test_gradients_of_a_population_of_a_model(tables, monkeypatch, likelihood):
    model = declared(Case(chain(), record=BAND_LIMITED), likelihood, False)
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(4).uniform(-1.0, 1.0, (PARTICLES, 2))
    *_, slope = found = logp.gradient(particles)
    assert len(tables) > 0 and all(sure.all() for sure in tables)
    for module in (population, gradients):
        monkeypatch.setattr(module, "FEWEST_STEPS", 5 * N_TIMES)
    tables.clear()
    *_, expected_slope = expected = logp.gradient(particles)
    assert tables == []
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-10)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-8, atol=1e-10 * abs(expected_slope).max())


@pytest.mark.parametrize(
    ("likelihood", "as_data"),
    [(TruncNormalFeature, False), (CorrelatedNormal, True)],
    ids=["constant", "pm.Data"],
)
def test_a_lone_chain(tables, monkeypatch, likelihood, as_data):
    """Value and gradient as NUTS has them; constants, whose memory has no owner, are known again."""
    record = records.Record(noise(4003), DT)
    case, point = Case(chain(), record=record), np.array([0.3, -0.2])
    model = declared(case, likelihood, as_data)
    logp = model.logp_dlogp_function(ravel_inputs=True)
    logp.set_extra_values({})
    expected = logp(point)
    assert tables == []  # four modes: faster by the march
    monkeypatch.setattr(population, "LEAST_ALONE", 0)
    hashed, original = [], kept.Kept.by_hash
    monkeypatch.setattr(kept.Kept, "by_hash", lambda *given: hashed.append(0) or original(*given))
    for _ in range(3):
        found = logp(point)
    assert len(tables) >= 6 and all(sure.all() for sure in tables) and len(hashed) <= 2
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-10)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-8)


def test_many_sensors(tables):
    """More functions than a vector has lanes."""
    case = Case(chain())
    wanted = case.arguments[2]._replace(sensors=np.arange(11) % 4)
    case.arguments = *case.arguments[:2], wanted
    case.observed = noise((11, N_TIMES), 8)
    weights = noise((PARTICLES, 11, 4), 3)
    assert errors(by_table(case, weights), marched(case, weights)).max() < 1e-10
    assert tables[0].all()
