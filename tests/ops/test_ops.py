"""The Ops: Numba, Python and NumPy agree; batches, shapes, caches, and the refusal of gradients."""

import functools
import pickle
import warnings

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from packaging.version import Version
from pymc.sampling.mcmc import assign_step_methods
from pytensor.graph.replace import vectorize_graph

from pymc_features import (
    CorrelatedNormal,
    DiscrepancySimulator,
    ExpFeature,
    TruncNormalFeature,
    mean_square_discrepancy,
    response,
    simulate,
)
from pymc_features.exceptions import NotDifferentiableError
from pymc_features.ops import (
    OPS,
    StructuralDiscrepancy,
    StructuralMisfit,
    StructuralResponse,
)
from pymc_features.ops.structural import count
from pymc_features.simulators import FAMILIES, QUANTITIES, n_outputs
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.graphs import PLAIN, REWRITTEN, our_ops, our_ops_of
from support.kernels import chain_discrepancy, chain_response
from support.straight import Record
from support.structures import noise_record, three_storeys, with_first_spring, with_noise

CORRELATED = functools.partial(CorrelatedNormal, correlation_time=0.1)
CHAIN = FAMILIES["chain"]
N_TIMES = 140  # beyond one block of the recursion
N_DOF = 3


@pytest.fixture(scope="module")
def pulse():
    return noise_record(N_TIMES)


@pytest.fixture(scope="module")
def measured(pulse):
    return with_noise(simulate(three_storeys(100.0), pulse))


def symbolic_inputs():
    """One variable for each input of the Ops, nothing known before run time."""
    return [
        pt.TensorType(CHAIN.dtype(name), (None,) * count(dims))(name) for name, dims in CHAIN.inputs.items()
    ]


def numeric_inputs(seed, substeps=1, stride=1, sensors=(0, 1, 2), n_modes=3, n_times=N_TIMES):
    rng = np.random.default_rng(seed)
    return [
        rng.uniform(0.5, 2.0, N_DOF),
        rng.uniform(50.0, 500.0, N_DOF),
        rng.uniform(0.0, 0.01, 2),
        rng.uniform(0.0, 0.1, N_DOF),
        rng.normal(size=n_times),
        0.02,
        substeps,
        stride,
        NO_DIRECT,
        np.array(sensors),
        n_modes,
    ]


SETTINGS = [
    {},
    {"stride": 5, "n_modes": 1, "sensors": (0, 0)},
    {"substeps": 10, "sensors": (1, 0), "n_modes": 2, "n_times": 30},
]


@pytest.fixture(scope="module")
def compiled():
    """[response, fused discrepancy] of two quantities in one Numba graph, and the warnings it gave."""
    inputs, observed = symbolic_inputs(), pt.matrix("observed")
    outputs = []
    for quantity in QUANTITIES[::3]:
        outputs += [StructuralResponse(quantity)(*inputs), StructuralDiscrepancy(quantity)(*inputs, observed)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        function = pytensor.function([*inputs, observed], outputs, mode="NUMBA")
        function(*numeric_inputs(0), np.zeros((N_DOF, N_TIMES)))
    return function, [str(w.message) for w in caught]


@pytest.fixture(scope="module")
def interpreted():
    """The same for all quantities in Python."""
    inputs, observed = symbolic_inputs(), pt.matrix("observed")
    outputs = []
    for quantity in QUANTITIES:
        outputs += [StructuralResponse(quantity)(*inputs), StructuralDiscrepancy(quantity)(*inputs, observed)]
    return pytensor.function([*inputs, observed], outputs, mode=PLAIN)


@pytest.mark.parametrize("case", range(len(SETTINGS)))
def test_numba_python_and_kernels_agree(compiled, interpreted, case):
    inputs = numeric_inputs(case, **SETTINGS[case])
    observed = np.random.default_rng(9).normal(
        size=(inputs[9].size, n_outputs(inputs[4].size, inputs[6], inputs[7]))
    )
    slow = interpreted(*inputs, observed)
    for code in range(len(QUANTITIES)):
        history, errors = slow[2 * code : 2 * code + 2]
        near = {"rtol": 1e-12, "atol": 1e-12 * np.abs(history).max()}
        np.testing.assert_allclose(history, chain_response(*inputs, code), **near)
        np.testing.assert_array_equal(errors, chain_discrepancy(*inputs, code, observed))
        np.testing.assert_allclose(errors, np.mean((observed - history) ** 2, axis=1), rtol=1e-12)
    fast = compiled[0](*inputs, observed)
    for ours, code in zip(range(0, 4, 2), (0, 3), strict=True):
        for k in range(2):
            expected = slow[2 * code + k]
            np.testing.assert_allclose(
                fast[ours + k], expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
            )


def test_numba_takes_the_kernels_not_object_mode(compiled):
    assert [w for w in compiled[1] if "object mode" in w] == []
    assert our_ops_of(compiled[0]) >= {StructuralResponse, StructuralDiscrepancy}


@pytest.mark.parametrize("wrap", ["plain", "deterministic", "named copy", "specified shape"])
def test_fused_discrepancy_equals_unfused(pulse, measured, wrap):
    stiffness = pt.vector("stiffness", shape=(N_DOF,))
    mu = response(three_storeys(stiffness), pulse)
    with pm.Model():
        wrapped = {
            "plain": lambda: mu,
            "deterministic": lambda: pm.Deterministic("mu", mu),
            "named copy": lambda: mu.copy(name="again"),
            "specified shape": lambda: pt.specify_shape(mu, (N_DOF, None)),
        }[wrap]()
    fused = mean_square_discrepancy(wrapped, measured)
    assert our_ops([fused]) == {StructuralDiscrepancy}
    assert fused.type.shape == (N_DOF,)
    unfused = pt.mean((mu - measured) ** 2, axis=-1)
    function = pytensor.function([stiffness], [fused, unfused], mode=PLAIN)
    for values in ([100.0] * 3, [30.0, 200.0, 90.0], [1.0, 1e4, 1e-3]):
        a, b = function(values)
        np.testing.assert_allclose(a, b, rtol=1e-12)
    assert np.isnan(function([100.0, -1.0, 100.0])).all()


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_fused_discrepancy_is_of_what_was_asked(pulse, quantity):
    """Quantity, output step, sensors and modes of the response reach the fused Op."""
    for asked in ({"dt": 0.04}, {"dt": 0.01, "sensors": [2, 0], "n_modes": 2}):
        exact = simulate(three_storeys(100.0), pulse, quantity=quantity, **asked).values
        data = exact + np.random.default_rng(2).normal(size=exact.shape) * np.abs(exact).max()
        e = mean_square_discrepancy(response(three_storeys(100.0), pulse, quantity=quantity, **asked), data)
        assert our_ops([e]) == {StructuralDiscrepancy}
        np.testing.assert_allclose(e.eval(mode=PLAIN), np.mean((data - exact) ** 2, axis=1), rtol=1e-12)


def test_other_expressions_are_not_fused(pulse, measured):
    """What is no copy of a response is computed as it stands."""
    mu = response(three_storeys(100.0), pulse)
    exact = simulate(three_storeys(100.0), pulse).values
    cases = {
        "scaled": (2.0 * mu, 2.0 * exact, measured),
        "shifted": (mu + 1.0, exact + 1.0, measured),
        "flipped": (mu[::-1], exact[::-1], measured),
        "transposed": (mu.T, exact.T, measured.T),
        "constant": (pt.as_tensor_variable(exact), exact, measured),
    }
    for name, (tensor, numbers, data) in cases.items():
        e = mean_square_discrepancy(tensor, data)
        assert StructuralDiscrepancy not in our_ops([e]), name
        expected = np.mean((numbers - data) ** 2, axis=-1)
        np.testing.assert_allclose(e.eval(mode=PLAIN), expected, rtol=1e-13, err_msg=name)


def test_batch_of_data_against_one_response(pulse, measured):
    data = np.stack([measured, 2.0 * measured])
    mu = response(three_storeys(100.0), pulse)
    e = mean_square_discrepancy(mu, data)
    assert our_ops([e]) == {StructuralDiscrepancy}
    np.testing.assert_allclose(
        e.eval(mode=PLAIN), mean_square_discrepancy(np.stack([mu.eval(mode=PLAIN)] * 2), data), rtol=1e-12
    )


def test_records_of_equal_length_are_not_confused(pulse):
    """Two responses in one graph differ in their record only; optimisation must not merge them."""
    other = Record(pulse.acceleration[::-1], pulse.dt, name=pulse.name)
    outputs = [response(three_storeys(100.0), record) for record in (pulse, other)]
    a, b = pytensor.function([], outputs, mode=REWRITTEN)()
    np.testing.assert_array_equal(a, simulate(three_storeys(100.0), pulse).values)
    np.testing.assert_array_equal(b, simulate(three_storeys(100.0), other).values)


def of_batch(pulse, measured, batch):
    """Response and discrepancy of a population of springs."""
    stiffness = pt.vector("k", shape=(N_DOF,))
    mu = response(three_storeys(stiffness), pulse)
    return vectorize_graph([mu, mean_square_discrepancy(mu, measured)], {stiffness: batch})


def test_shapes_are_known_without_computing(pulse, measured):
    """Functions of the shape do not contain the Op, and are right for any sampling, and of batches."""
    inputs, observed = symbolic_inputs(), pt.matrix("observed")
    mu, e = StructuralResponse()(*inputs), StructuralDiscrepancy()(*inputs, observed)
    statistics = StructuralMisfit()(*inputs, observed)
    assert mu.type.shape == (None, None)
    shape = pytensor.function(
        [*inputs, observed],
        [*mu.shape, *e.shape, *statistics.shape],
        mode=REWRITTEN,
        on_unused_input="ignore",
    )
    assert our_ops_of(shape) == set()
    for case, settings in enumerate(SETTINGS):
        values = numeric_inputs(case, **settings)
        expected = chain_response(*values, 0).shape
        got = [int(x) for x in shape(*values, np.zeros((1, 1)))]
        assert got == [*expected, expected[0], expected[0], 4]
    batch = pt.matrix("batch", shape=(None, N_DOF))
    sizes = [size for x in of_batch(pulse, measured, batch) for size in x.shape]
    function = pytensor.function([batch], sizes, mode=REWRITTEN)
    assert our_ops_of(function) == set()
    assert [int(n) for n in function(np.ones((7, N_DOF)))] == [7, N_DOF, N_TIMES, 7, N_DOF]


@pytest.fixture(scope="module")
def batched(pulse, measured):
    """Response and discrepancy of a population, compiled by Numba."""
    batch = pt.matrix("batch", shape=(None, N_DOF))
    outputs = of_batch(pulse, measured, batch)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        function = pytensor.function([batch], outputs, mode="NUMBA")
        function(np.full((1, N_DOF), 100.0))
    return function


def test_batch_of_particles(batched, pulse, measured):
    """Each row as alone; the invalid particle is NaN in its own row only; and after pickling."""
    population = np.random.default_rng(6).uniform(20.0, 400.0, (5, N_DOF))
    population[3, 1] = -1.0
    histories, errors = batched(population)
    assert histories.shape == (5, N_DOF, N_TIMES)
    assert errors.shape == (5, N_DOF)
    for row in (0, 1, 2, 4):
        expected = simulate(three_storeys(population[row]), pulse).values
        np.testing.assert_allclose(histories[row], expected, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(errors[row], mean_square_discrepancy(expected, measured), rtol=1e-12)
    assert np.isnan(histories[3]).all() and np.isnan(errors[3]).all()
    again = pickle.loads(cloudpickle.dumps(batched))  # as a worker gets it
    for a, b in zip(again(population), (histories, errors), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("pickler", [pickle, cloudpickle])
def test_ops_and_functions_survive_pickling(pickler, pulse, measured):
    ops = [op(quantity) for op in OPS for quantity in QUANTITIES]
    again = pickle.loads(pickler.dumps(ops))
    assert again == ops and [hash(op) for op in again] == [hash(op) for op in ops]
    assert len(set(ops)) == len(OPS) * len(QUANTITIES)
    stiffness = pt.scalar("k")
    e = mean_square_discrepancy(response(three_storeys(stiffness), pulse), measured)
    function = pytensor.function([stiffness], e, mode=PLAIN)
    again = pickle.loads(pickler.dumps(function))
    np.testing.assert_array_equal(again(80.0), function(80.0))


def test_data_must_fit_the_response(pulse, measured):
    mu = response(three_storeys(100.0), pulse)
    shape = r"must have shape \(sensor, time\) = \(3, 140\) to match `mu`, got "
    with pytest.raises(ValueError, match=shape + r"\(140, 3\). Transpose it: time is the last axis"):
        mean_square_discrepancy(mu, measured.T)
    with pytest.raises(ValueError, match=shape + r"\(3, 139\). Give one row for each sensor"):
        mean_square_discrepancy(mu, measured[:, 1:])
    with pytest.raises(ValueError, match=shape + r"\(2, 140\)"):
        mean_square_discrepancy(mu, pt.tensor("y", shape=(2, 140)))
    with pytest.raises(ValueError, match=r"= \(2, 4\) to match `mu`, got \(4, 2\). Transpose it"):
        mean_square_discrepancy(np.zeros((2, 4)), np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"`observed` must be \(sensor, time\), got 1 dimensions"):
        StructuralDiscrepancy()(*mu.owner.inputs, measured[0])
    with pytest.raises(ValueError, match="`mass` must have 1 dimensions, got 2. Use `pytensor.graph.vec"):
        StructuralDiscrepancy()(pt.matrix("mass"), *mu.owner.inputs[1:], measured)
    unknown = pt.matrix("y")  # found out at run time only
    e = mean_square_discrepancy(mu, unknown)
    with pytest.raises(ValueError, match="`observed` or the cotangent must have the shape"):
        e.eval({unknown: measured.T}, mode=PLAIN)


@pytest.mark.parametrize(
    ("settings", "error", "match"),
    [
        ({"quantity": "base_shear", "sensors": [0]}, ValueError, "`sensors` must be left out for the base s"),
        ({"outputs": pt.matrix()}, TypeError, "`outputs` must be a matrix of numbers, got TensorVariable"),
        ({"dt": 0.03}, ValueError, "`dt` must"),
        ({"sensors": [5]}, ValueError, "`sensors` must"),
        ({"quantity": "drift"}, ValueError, "`quantity` must"),
        ({"n_modes": "all"}, ValueError, "`n_modes` must be an integer from 1 to 3, got 'all'"),
        ({"dt": pt.scalar()}, TypeError, "`dt` must be a number, got TensorVariable. .* may be pm.Data"),
        ({"structure": "chain"}, TypeError, "`structure` must be a Structure, got str. Pass for ex"),
        ({"record": [0.0, 1.0]}, TypeError, r"`record` must be a Record, got list. Use read_record"),
    ],
)
def test_response_refuses_wrong_settings(pulse, settings, error, match):
    with pytest.raises(error, match=match):
        response(**{"structure": three_storeys(100.0), "record": pulse} | settings)


def build_model(likelihood, pulse, measured):
    """Unknown stiffness and sigma under one of the ways to compare response and data."""
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        mu = response(with_first_spring(theta), pulse)
        if likelihood == "ABC":
            DiscrepancySimulator("y", mu, epsilon=4.0, observed=measured)
            return model
        sigma = pm.Uniform("sigma", 0.1, 3.0)
        likelihood("y", mu=mu, sigma=sigma, observed=measured)
    return model


@pytest.mark.parametrize("likelihood", [TruncNormalFeature, ExpFeature, CORRELATED, pm.Normal])
def test_nuts_is_assigned(likelihood, pulse, measured):
    """PyMC falls back to Metropolis or Slice, silently, where a gradient is missing."""
    _, assigned = assign_step_methods(build_model(likelihood, pulse, measured))
    assert {method: len(variables) for method, variables in assigned.items()} == {pm.NUTS: 2}


@pytest.mark.parametrize(
    ("kernel", "by_function"),
    [("uniform", False), ("exponential", False), ("gaussian", False), ("gaussian", True)],
)
def test_likelihood_free_models_get_nuts_or_an_error(kernel, by_function, pulse, measured):
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        if by_function:
            DiscrepancySimulator(
                "y", lambda t: measured * t, theta, epsilon=4.0, observed=measured, kernel=kernel
            )
        else:
            mu = response(with_first_spring(theta), pulse)
            DiscrepancySimulator("y", mu, epsilon=4.0, observed=measured, kernel=kernel)
    if kernel != "uniform" and not by_function:
        _, assigned = assign_step_methods(model)
        assert list(assigned) == [pm.NUTS]
    else:
        with pytest.raises(NotDifferentiableError, match=r"has no gradient. Sample with pmf.sample_smc\(\)"):
            assign_step_methods(model)


def test_the_advice_of_the_refusal_works(pulse, measured):
    """DEMetropolisZ samples, and Powell's method finds the mode."""
    with build_model("ABC", pulse, measured), pytensor.config.change_flags(mode="FAST_COMPILE"):
        quiet = {"tune": 20, "progressbar": False, "random_seed": 1, "cores": 1}
        with pytest.raises(NotDifferentiableError, match=r"pm.sample\(step=pm.DEMetropolisZ\(\)\)"):
            pm.sample(draws=20, chains=1, **quiet)
        idata = pm.sample(
            draws=20, chains=2, step=pm.DEMetropolisZ(), compute_convergence_checks=False, **quiet
        )
        assert idata.posterior["theta"].shape == (2, 20)
        if Version(pm.__version__) >= Version(
            "6.4"
        ):  # which no longer asks for a gradient that it does not use
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FutureWarning)
                mode = pm.find_MAP(method="powell", progressbar=False)
            assert 0.5 < mode["theta"] < 1.5


@pytest.mark.parametrize("likelihood", [TruncNormalFeature, ExpFeature])
def test_likelihood_graph_never_holds_the_history(likelihood, pulse, measured):
    model = build_model(likelihood, pulse, measured)
    for inside in ([model.logp()], [model.logp(jacobian=False)]):
        assert our_ops(inside) == {StructuralDiscrepancy}
    assert our_ops_of(model.compile_logp(mode=REWRITTEN)) == {StructuralDiscrepancy}
    with pm.Model() as control:  # negative control: heavy tails need every sample
        mu = response(three_storeys(pm.Uniform("k", 50.0, 200.0)), pulse)
        pm.StudentT("y", nu=4.0, mu=mu, sigma=1.0, observed=measured)
    assert our_ops_of(control.compile_logp(mode=REWRITTEN)) == {StructuralResponse}
