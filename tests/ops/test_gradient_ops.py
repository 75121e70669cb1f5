"""Gradients in graphs and models: pt.grad, forward mode, batches, shapes, and what is refused."""

import warnings

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.compile.mode import Mode
from pytensor.gradient import DisconnectedInputError, NullTypeGradError, pushforward
from pytensor.graph.replace import vectorize_graph
from pytensor.graph.traversal import ancestors

from pymc_features import (
    ExpFeature,
    HystereticChain,
    ModalDamping,
    RayleighDamping,
    Record,
    SpringMassChain,
    TruncNormalFeature,
    mean_square_discrepancy,
    response,
)
from pymc_features.ops import (
    DiscrepancyTangent,
    MisfitGradient,
    PopulationDiscrepancy,
    PopulationGradient,
    ResponseGradient,
    ResponseTangent,
    StructuralDiscrepancy,
    StructuralResponse,
)
from pymc_features.ops.gradient import Gradient, is_constant
from pymc_features.ops.structural import count
from pymc_features.simulators import FAMILIES, QUANTITIES
from support.graphs import PLAIN, our_ops
from support.kernels import (
    chain_response,
    discrepancy_gradient,
    discrepancy_tangent,
    response_gradient,
    response_tangent,
)
from support.random_chains import population, random_chain
from support.reference import richardson
from support.structures import noise_record

CHAIN = FAMILIES["chain"]

SENSORS, QUANTITY = [2, 0], "relative_velocity"  # not the default, which an Op might fall back to
RECORD = noise_record(150, seed=3)
MASS, STIFFNESS, RATIOS = (pt.vector(name, shape=(3,)) for name in ("mass", "stiffness", "ratios"))
ALPHA, BETA = pt.scalar("alpha"), pt.scalar("beta")
WEIGHTS, OBSERVED, C = pt.matrix("weights"), pt.matrix("observed", shape=(2, None)), pt.vector("c")
WRT = {"rayleigh": [MASS, STIFFNESS, ALPHA, BETA], "modal": [MASS, STIFFNESS, RATIOS]}
DAMPED = {"rayleigh": RayleighDamping(ALPHA, BETA), "modal": ModalDamping(RATIOS)}


def symbolic(kind, quantity=QUANTITY):
    """Response at two sensors and every second sample, and its discrepancy."""
    chain = SpringMassChain(MASS, STIFFNESS, DAMPED[kind])
    mu = response(chain, RECORD, dt=0.04, sensors=SENSORS, quantity=quantity)
    return mu, mean_square_discrepancy(mu, OBSERVED)


def numbers(kind):
    """Values of the parameters in `WRT`, the same as kernel arguments, and weights, data and c."""
    arguments = random_chain(
        3, quantity=2, acceleration=RECORD.acceleration, stride=2, sensors=np.array(SENSORS)
    )
    arguments[3] = np.array([0.02, 0.05, 0.01]) if kind == "modal" else np.zeros(3)
    arguments[2] = np.zeros(2) if kind == "modal" else arguments[2]
    values = [*arguments[:2], *([arguments[3]] if kind == "modal" else arguments[2])]
    rng = np.random.default_rng(4)
    return values, arguments, [rng.normal(size=(2, 75)), rng.normal(size=(2, 75)), rng.normal(size=2)]


def in_order_of(kind, gradients):
    """Gradients by the parameters in `WRT` out of a kernel's."""
    mass, stiffness, rayleigh, ratios = gradients
    return [mass, stiffness, *([ratios] if kind == "modal" else rayleigh)]


def assert_all_close(actual, expected, rtol):
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * np.abs(b).max())


@pytest.mark.parametrize(
    ("kind", "mode", "quantity"),
    [("rayleigh", "NUMBA", QUANTITY), *(("modal", "FAST_COMPILE", q) for q in QUANTITIES)],
)
def test_gradients_of_graphs(kind, mode, quantity):
    """pt.grad of response and discrepancy, by all parameters and by the data, without object mode.

    The gradient of a batch, and the batch of gradients, too; what all share gets the sum.
    """
    mu, e = symbolic(kind, quantity)
    gradients = pt.grad((WEIGHTS * mu).sum(), WRT[kind]) + pt.grad((C * e).sum(), [*WRT[kind], OBSERVED])
    assert our_ops(gradients) >= {ResponseGradient, MisfitGradient}
    batch, cost = pt.matrix("batch", shape=(None, 3)), (C * e).sum()
    cost, *slopes = vectorize_graph([cost, *pt.grad(cost, [MASS, STIFFNESS])], {STIFFNESS: batch})
    assert our_ops([cost]) == {PopulationDiscrepancy}
    total = pt.grad(cost.sum(), [MASS, batch], disconnected_inputs="ignore")
    assert our_ops(total) >= {PopulationGradient}
    values, arguments, (weights, observed, c) = numbers(kind)
    arguments[-1] = list(QUANTITIES).index(quantity)
    springs = arguments[1] * np.random.default_rng(8).uniform(0.5, 1.5, (4, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inputs = [*WRT[kind], WEIGHTS, OBSERVED, C, batch]
        function = pytensor.function(inputs, [*total, *slopes, *gradients], mode=mode)
        got = function(*values, weights, observed, c, springs)
    single = [discrepancy_gradient(arguments[0], k, *arguments[2:], observed, c) for k in springs]
    by_mass, by_stiffness = (np.stack([g[i] for g in single]) for i in range(2))
    assert_all_close(got[:4], [by_mass.sum(axis=0), by_stiffness, by_mass, by_stiffness], 1e-10)
    expected = [
        *in_order_of(kind, response_gradient(*arguments, weights)),
        *in_order_of(kind, discrepancy_gradient(*arguments, observed, c)),
        c[:, None] * 2.0 / 75 * (observed - chain_response(*arguments)),
    ]
    assert_all_close(got[4:], expected, 1e-10)
    values[0] = -values[0]  # no structure is no exception
    assert all(np.isnan(g).all() for g in function(*values, weights, observed, c, springs)[4:-1])


def test_forward_mode():
    """pushforward, a double pullback by hand, and the rows of the Jacobian agree with the kernels."""
    kind = "rayleigh"
    mu, e = symbolic(kind)
    d, dummies = [x.type() for x in WRT[kind]], [pt.matrix(), pt.vector()]
    forward, twice = [pushforward(y, WRT[kind], d) for y in (mu, e)], []
    assert our_ops(forward) >= {ResponseTangent, DiscrepancyTangent}
    for y, v in zip((mu, e), dummies, strict=True):
        back = pt.grad((v * y).sum(), WRT[kind])
        twice.append(pt.grad(sum((g * x).sum() for g, x in zip(back, d, strict=True)), v))
    rows = pt.jacobian(e, WRT[kind], vectorize=True)
    function = pytensor.function(
        [*WRT[kind], *d, *dummies, OBSERVED], [*forward, *twice, *rows], mode="FAST_COMPILE"
    )
    values, arguments, (weights, observed, c) = numbers(kind)
    along = [np.random.default_rng(i).normal(size=np.shape(v)) for i, v in enumerate(values)]
    got = function(*values, *along, weights, c, observed)
    full = [*along[:2], np.array(along[2:]), np.zeros(3)]
    expected = [response_tangent(*arguments, *full), discrepancy_tangent(*arguments, observed, *full)]
    assert_all_close(got[:4], expected * 2, 1e-10)
    by_row = [in_order_of(kind, discrepancy_gradient(*arguments, observed, unit)) for unit in np.eye(2)]
    assert_all_close(got[4:], [np.stack(x) for x in zip(*by_row, strict=True)], 1e-10)


def sought_in(gradient):
    """What the gradients in a graph are told that they are wanted by."""
    ops = (v.owner.op for v in ancestors([gradient]) if v.owner is not None)
    return {op.sought for op in ops if isinstance(op, Gradient)}


def test_gradients_of_chains_that_yield_ask_what_is_sought():
    """Of one structure and of a batch: the stiffness and one row of the table of the law are variables."""
    theta, rows = pt.vector("theta", shape=(2,)), pt.matrix("rows", shape=(None, 2))
    law = {"yield_displacement": theta[1], "post_yield_ratio": 0.1, "sharpness": 2.0}
    frame = HystereticChain(np.ones(3), 100.0 * theta[0], ModalDamping(0.02), **law)
    cost = mean_square_discrepancy(response(frame, Record(np.ones(9), 0.02)), np.zeros((3, 9))).sum()
    for value, by in ((cost, theta), (vectorize_graph(cost, {theta: rows}).sum(), rows)):
        assert sought_in(pt.grad(value, by)) == {("stiffness", "law[0]")}
    law["yield_displacement"] = 0.01
    other = HystereticChain(theta[0] * np.ones(3), 100.0, ModalDamping(theta[1]), **law)
    history = response(other, Record(np.ones(9), 0.02)).sum()
    assert sought_in(pt.grad(history, theta)) == {("mass", "ratios")}
    long = pt.constant(np.ones(3))
    for _ in range(2000):  # deeper than Python's stack, and each variable twice
        long = 0.5 * (long + long)
    assert is_constant(long) and not is_constant(long * theta[0])


def test_forward_mode_of_a_population():
    """PopulationGradient is linear in its weights: its pullback gives each particle's tangent."""
    arguments, observed, _ = population(shared=(0,))
    batches = [pt.matrix(shape=(1 if len(x) == 1 else None, x.shape[1])) for x in arguments[:4]]
    e = PopulationDiscrepancy(QUANTITY)(*batches, *arguments[4:-1], observed)
    d = [np.random.default_rng(i).normal(size=x.shape) for i, x in enumerate(arguments[:4])]
    forward = pushforward(e, batches, [pt.as_tensor(x) for x in d])
    got = pytensor.function(batches, forward, mode=PLAIN)(*arguments[:4])
    for p in range(5):
        own, along = ([x[p % len(x)] for x in rows] for rows in (arguments[:4], d))
        expected = discrepancy_tangent(*own, *arguments[4:], observed, *along)
        np.testing.assert_allclose(got[p], expected, rtol=1e-10)


def derivative_ops():
    """Each Op with inputs of which nothing is known: its outputs, and all its inputs."""
    common = [
        pt.TensorType(CHAIN.dtype(name), (None,) * count(dims))(name) for name, dims in CHAIN.inputs.items()
    ]
    batches = [pt.matrix() for _ in range(4)]
    data, more, d = pt.matrix("data"), pt.matrix("more"), [x.type() for x in common[:4]]
    return {
        ResponseGradient: [*common, data],
        ResponseTangent: [*common, *d],
        MisfitGradient: [*common, data, more],
        DiscrepancyTangent: [*common, data, *d],
        PopulationGradient: [*batches, *common[4:], data, pt.tensor3("c")],
    }


@pytest.mark.parametrize("op", derivative_ops())
def test_shapes_are_known_without_computing(op):
    """Of every output; the compiled shapes do not contain the Op; inputs that do not fit are refused."""
    inputs = derivative_ops()[op]
    outputs = op()(*inputs)
    outputs = outputs if isinstance(outputs, list) else [outputs]
    shapes = [size for x in outputs for size in x.shape]
    fast = Mode(linker="py", optimizer="fast_run")
    function = pytensor.function(inputs, shapes, mode=fast, on_unused_input="ignore")
    assert our_ops(function.maker.fgraph.outputs) == set()
    arguments, observed, c = population(shared=(3,))
    if op is not PopulationGradient:
        arguments[:4], c = [x[0] for x in arguments[:4]], c[0]
    c = c[..., None]
    more = {ResponseGradient: [observed], MisfitGradient: [observed, c]}
    more |= {ResponseTangent: arguments[:4], DiscrepancyTangent: [observed, *arguments[:4]]}
    values = [*arguments[:-1], *more.get(op, [observed, c])]
    results = pytensor.function(inputs, outputs, mode=PLAIN)(*values)
    assert [int(n) for n in function(*values)] == [n for x in results for n in x.shape]
    for wrong in (inputs[:-1], [*inputs, pt.vector()], [*inputs[:-1], pt.tensor4()]):
        with pytest.raises(ValueError, match=f"{op.__name__} takes {len(inputs) - 11} more inputs of"):
            op()(*wrong)


def test_settings_are_disconnected():
    """Record, step and sensors have no gradient, and the derivative Ops have none by them either."""
    step, ground = pt.scalar("dt"), pt.vector("acceleration")
    arguments = random_chain(3)
    settings = [ground, step, *arguments[6:11]]
    for y in (
        StructuralResponse()(*arguments[:4], *settings),
        StructuralDiscrepancy()(*arguments[:4], *settings, np.zeros((3, 150))),
        ResponseGradient()(*arguments[:4], *settings, np.zeros((3, 150)))[0],
        DiscrepancyTangent()(*arguments[:4], *settings, np.zeros((3, 150)), *arguments[:4]),
    ):
        for variable in (step, ground):
            with pytest.raises(DisconnectedInputError):
                pt.grad(y.sum(), variable)


@pytest.mark.parametrize("what", ["response", "discrepancy", "population", "data", "forward"])
def test_second_derivatives_are_refused(what):
    """By the parameters, with words that say so."""
    mu, e = symbolic("modal")
    batch = pt.matrix("batch", shape=(None, 3))
    y = vectorize_graph(e, {STIFFNESS: batch}) if what == "population" else mu if what == "response" else e
    variable = batch if what == "population" else STIFFNESS
    first = pushforward(e, STIFFNESS, MASS) if what == "forward" else pt.grad(y.sum(), variable)
    with pytest.raises(NullTypeGradError, match="has first derivatives only"):
        pt.grad(first.sum(), OBSERVED if what == "data" else variable)
    by_data = pt.grad(pt.grad(e.sum(), OBSERVED).sum(), OBSERVED)  # negative control: this one exists
    inputs, zeros = [*WRT["modal"], OBSERVED], np.zeros((2, 75))
    got = pytensor.function(inputs, by_data, mode=PLAIN)(*np.ones((3, 3)), zeros)
    np.testing.assert_allclose(got, zeros + 2.0 / 75, rtol=1e-14)


@pytest.mark.parametrize("likelihood", [TruncNormalFeature, ExpFeature, pm.Normal])
def test_log_probability_of_models(likelihood):
    """Masses, springs, damping and sigma of a model: dlogp against differences of logp: measured 2e-10."""
    rng = np.random.default_rng(2)
    with pm.Model() as model:
        mass, stiffness = pm.LogNormal("mass", 0.0, 0.3, shape=3), pm.Gamma("k", 9.0, 0.05, shape=3)
        damping = RayleighDamping(pm.HalfNormal("alpha", 0.5), pm.HalfNormal("beta", 1e-2))
        mu = response(SpringMassChain(mass, stiffness, damping), RECORD, dt=0.04, sensors=SENSORS)
        sigma = pm.HalfNormal("sigma", 2.0, **({} if likelihood is pm.Normal else {"shape": 2}))
        likelihood("y", mu=mu, sigma=sigma, observed=rng.normal(size=(2, 75)))
    logp, slope = model.compile_logp(mode="FAST_COMPILE"), model.compile_dlogp(mode="FAST_COMPILE")
    point = {
        name: value + 0.1 * rng.normal(size=np.shape(value)) for name, value in model.initial_point().items()
    }
    got, expected = slope(point), []
    for variable in model.value_vars:
        start = point[variable.name]
        for i in np.ndindex(start.shape):

            def along(x, name=variable.name, start=start, i=i):
                moved = np.array(start)
                moved[i] = x
                return float(logp(point | {name: moved}))

            expected.append(richardson(along, start[i], h=2e-2))
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-10 * np.abs(got).max())
