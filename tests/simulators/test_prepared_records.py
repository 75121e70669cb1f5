"""Band-limited records in models: as `simulate`, for one structure and for many, with gradients."""

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph
from scipy.signal import firwin, lfilter

import pymc_features as pmf
from pymc_features.simulators.excitation import frequencies_of

pytestmark = pytest.mark.slow

DT, N = 0.01, 300


def motion(seed=0, n_inputs=1):
    """Noise up to 0.35 of the rate that begins and ends in motion, (n_inputs, time)."""
    rows = np.random.default_rng(seed).normal(size=(n_inputs, N + 100))
    return lfilter(firwin(61, 0.7), 1.0, rows)[:, 100:]


RECORD = pmf.Record(motion()[0], DT)
SUPPORTS = pmf.Loading(motion(1, 2), DT)
FORCES = pmf.Loading(motion(2, 1), DT, kind="force", matrix=[[0.0], [1.0], [3.0]])
SPRING = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
BASE = np.array([[2.0e3, -900.0, 0.0], [-900.0, 1700.0, -800.0], [0.0, -800.0, 800.0]])
DAMPING = pmf.RayleighDamping(0.3, 1e-3)
DASHPOT = np.diag([3.0, 0.5, 0.2]) + 0.3 * SPRING


def chain(theta, top=800.0, damping=None):
    stiffness = [900.0, 700.0 * theta[0], top * theta[1]]
    return pmf.SpringMassChain(np.array([1.0, 1.2, 0.9]), stiffness, damping or DAMPING)


def affine(theta, damping=None, influence=None, stiff=1.0):
    return pmf.AffineStructure(
        np.diag([1.0, 1.2, 0.0]),
        stiffness=BASE,
        damping=DAMPING if damping is None else damping,
        mass_terms=[None, np.diag([0.0, 0.0, 0.9])],
        stiffness_terms=[300.0 * stiff * SPRING, None],
        influence=influence,
        theta=theta,
    )


def hysteretic(theta):
    return pmf.HystereticChain(
        np.array([1.0, 1.2, 0.9]),
        [900.0, 700.0 * theta[0], 800.0 * theta[1]],
        DAMPING,
        yield_displacement=2e-3,
        post_yield_ratio=0.1,
        sharpness=2.0,
    )


TWO = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
CASES = {
    "chain": (chain, RECORD, {}),
    "chain, a fast mode": (lambda t: chain(t, top=3e6), RECORD, {}),
    "chain, a rigid spring": (lambda t: chain(t, top=1e16), RECORD, {}),
    "affine": (affine, RECORD, {}),
    "affine, two modes": (affine, RECORD, {"n_modes": 2}),
    "affine, a fast mode": (lambda t: affine(t, stiff=1e4), RECORD, {}),
    "forces": (affine, FORCES, {}),
    "supports": (lambda t: affine(t, influence=TWO), SUPPORTS, {}),
    "dashpots": (lambda t: affine(t, damping=DASHPOT), RECORD, {}),
    "dashpots, a fast mode": (lambda t: affine(t, damping=DASHPOT, stiff=1e6), RECORD, {}),
    "hysteretic": (hysteretic, RECORD, {}),
}
QUANTITIES = "absolute_acceleration", "relative_displacement"
AT = np.array([1.1, 0.9])


def with_data(case, quantity):
    """The parameters and the response of a model, the response expected, and that of other parameters."""
    structure, record, settings = CASES[case]
    settings = settings | {"quantity": quantity, "sensors": [0, 2]}
    expected = pmf.simulate(structure(AT), record, **settings).values
    data = pmf.simulate(structure(1.2 * AT), record, **settings).values
    with pm.Model():
        theta = pm.Uniform("theta", 0.8, 1.3, shape=2)
        mu = pmf.response(structure(theta), record, **settings)
    return theta, mu, expected, data


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("case", CASES)
def test_a_model_has_the_response_of_simulate(case, quantity):
    """Alone, in a population, compared with data, and with gradients: value 1e-9, gradient 2e-6."""
    theta, mu, expected, data = with_data(case, quantity)
    e = pmf.mean_square_discrepancy(mu, data)
    weights = np.array([0.7, 0.3]) / np.mean((data - expected) ** 2, axis=1)
    value, x = (e * weights).sum(), pt.vector("x", shape=(2,))
    value, own_mu = pytensor.graph.replace.graph_replace([value, mu], {theta: x})
    rows = pt.matrix("rows", shape=(None, 2))
    batch = vectorize_graph(value, {x: rows})
    run = pytensor.function([x], [own_mu, value, pytensor.grad(value, x)])
    of_batch = pytensor.function([rows], [batch, pytensor.grad(batch.sum(), rows)])
    response, alone, gradient = run(AT)
    assert abs(response - expected).max() < 1e-9 * abs(expected).max()
    is_marched = case != "hysteretic"  # histories of which take other steps than mean squares
    np.testing.assert_allclose(alone, 1.0, rtol=1e-9 if is_marched else 1e-6)
    places = AT + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, -0.05], [0.1, 0.1], [-0.1, 0.02]])
    together, gradients = of_batch(places)
    np.testing.assert_allclose(together, [run(p)[1] for p in places], rtol=1e-8 if is_marched else 1e-6)
    limit = {"hysteretic": 1e-4, "dashpots, a fast mode": 1e-5}.get(case, 2e-6)
    np.testing.assert_allclose(gradients, [run(p)[2] for p in places], rtol=limit, atol=limit)
    h = 1e-5
    differences = [(run(AT + h * d)[1] - run(AT - h * d)[1]) / (2 * h) for d in np.eye(2)]
    np.testing.assert_allclose(gradient, differences, rtol=limit, atol=limit * abs(gradient).max())


def test_the_frequencies_that_decide_how_finely_a_record_is_marched():
    """A uniform chain in closed form, and one with a rigid part, whose lowest one keeps all its digits."""
    n, rows, rigid = 7, np.ones((2, 7)), pmf.SpringMassChain([2.0, 3.0], [40.0, 1e22], DAMPING)
    rows[1, 3] = np.nan
    uniform = 2.0 * np.sqrt(900.0) * np.sin(np.pi * (2 * np.arange(4) + 1) / (4 * n + 2)) / (2.0 * np.pi)
    _, stiffness, *damping = pmf.SpringMassChain(np.ones(n), 900.0, DAMPING).parameters()
    found = frequencies_of(rigid, (rows, *(np.asarray(x)[None] for x in (stiffness, *damping))), (), 4)
    np.testing.assert_allclose(found, [uniform, np.full(4, np.nan)], rtol=1e-13)
    lowest = frequencies_of(rigid, [np.asarray(x)[None] for x in rigid.parameters()], (), 2)[0, 0]
    np.testing.assert_allclose(lowest, np.sqrt(40.0 / 5.0) / (2.0 * np.pi), rtol=1e-13)
