"""JAX: every Op and model as by the kernels; jax.grad, jax.vmap, NUTS; loaded late; what it refuses."""

import functools
import sys

import arviz as az
import jax
import jax.numpy as jnp
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph

import pymc_features as pmf
from pymc_features import ops, paper, response, simulate
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.likelihoods.exact import quadrature
from pymc_features.ops import OPS
from pymc_features.ops.base import count
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.commands import run_python
from support.graphs import PLAIN
from support.kernels import DAMPINGS
from support.structures import noise_record, three_storeys, with_first_spring, with_noise

pytestmark = pytest.mark.slow

CHAIN = FAMILIES["chain"]
LIMIT = 1e-10  # relative, for each block of each output
N_TIMES = 60


@pytest.fixture(scope="module", autouse=True)
def started():
    """JAX runs from here on, not from collection: other tests fork.

    Before pymc.sampling.jax is imported, which would make a hundred devices of one processor.
    """
    return jax.devices()


# --------------------------------------------------------------------------- all Ops against the kernels

SETTINGS = {  # quantity, degrees of freedom, substeps, stride, modes, sensors
    "3 masses": ("absolute_acceleration", 3, 1, 1, 3, (0, 1, 2)),
    "1 mass, coarser": ("relative_velocity", 1, 1, 3, 1, (0,)),
    "2 masses, finer": ("relative_displacement", 2, 5, 1, 2, (1,)),
    "5 masses, 2 modes, 2 in 3 steps": ("relative_acceleration", 5, 3, 2, 2, (4, 0, 0, 3)),
}
REPEATED = {  # nearly, and to the last bit: settings, mass, stiffness, and what rounding allows
    **{f"soft {e:g}": ("3 masses", [1.0] * 3, [1e3, 1e3 * e, 500.0], LIMIT) for e in (1e-5, 1e-9, 1e-300)},
    "absorber 1e-6": ("2 masses, finer", [1.0, 1e-6], [1e3, 1e-3], 2e-9),
    "absorber 1e-9": ("2 masses, finer", [1.0, 1e-9], [1e3, 1e-6], 1e-7),
}
TANGENTS = (ops.ResponseTangent, ops.DiscrepancyTangent)
GRADIENTS = (ops.ResponseGradient, ops.MisfitGradient, ops.PopulationGradient)


def graph(quantity, substeps, stride, n_modes):
    """Inputs and outputs of all Ops: nothing but the sampling and the modes is a constant."""
    common = [
        pt.TensorType(CHAIN.dtype(name), (None,) * count(dims))(name) for name, dims in CHAIN.inputs.items()
    ]
    given = [*common[:6], common[9]]
    common[6:9], common[10] = (substeps, stride, NO_DIRECT), n_modes
    rows, d = [pt.matrix() for _ in range(4)], [pt.vector() for _ in range(4)]
    weights, data, c, many_c = pt.matrix("weights"), pt.matrix("data"), pt.vector("c"), pt.matrix("many_c")
    batch = [*rows, *common[4:], data]
    arguments = {
        ops.StructuralResponse: common,
        ops.StructuralDiscrepancy: [*common, data],
        ops.PopulationDiscrepancy: batch,
        ops.StructuralMisfit: [*common, data],
        ops.PopulationMisfit: batch,
        ops.ResponseGradient: [*common, weights],
        ops.ResponseTangent: [*common, *d],
        ops.MisfitGradient: [*common, data, c[:, None]],
        ops.DiscrepancyTangent: [*common, data, *d],
        ops.PopulationGradient: [*batch, many_c[..., None]],
    }
    outputs = [op(quantity)(*arguments[op]) for op in OPS]
    flat = [x for y in outputs for x in (y if isinstance(y, list) else [y])]
    return [*given, *rows, *d, weights, data, c, many_c], flat


def values_of(settings, damping, mass=None, stiffness=None):
    """Numbers for the inputs of `graph`: three particles share masses and ratios; one is alone."""
    _, n, substeps, stride, _, sensors = SETTINGS[settings]
    rng = np.random.default_rng(n)
    rayleigh, ratios = DAMPINGS[damping](n)
    parameters = [
        rng.uniform(0.5, 2.0, n) if mass is None else np.array(mass),
        rng.uniform(30.0, 300.0, n) * n if stiffness is None else np.array(stiffness),
        np.array(rayleigh),
        ratios,
    ]
    count = 1 if n == 1 else 3
    sizes = (1, count, count, 1)
    rows = [x * rng.uniform(0.7, 1.3, (size, 1)) for x, size in zip(parameters, sizes, strict=True)]
    d = [x * rng.normal(size=x.size) for x in parameters]
    if mass is not None:
        d[3] = 0.1 * ratios  # of modes that are one and the same, damping has one derivative
    shape = (len(sensors), ((N_TIMES - 1) * substeps) // stride + 1)
    ground, weights, data = rng.normal(size=N_TIMES), rng.normal(size=shape), rng.normal(size=shape)
    c, many_c = rng.uniform(0.5, 1.5, len(sensors)), rng.uniform(0.5, 1.5, (count, len(sensors)))
    return [*parameters, ground, 0.02, np.array(sensors), *rows, *d, weights, data, c, many_c]


@functools.cache
def compiled(mode, quantity, substeps, stride, n_modes):
    return pytensor.function(*graph(quantity, substeps, stride, n_modes), mode=mode)


def results(mode, settings, values):
    """{Op: outputs}, which are double whatever the mode."""
    quantity, _, substeps, stride, n_modes, _ = SETTINGS[settings]
    flat = iter(compiled(mode, quantity, substeps, stride, n_modes)(*values))
    found = {op: [next(flat) for _ in range(4 if op in GRADIENTS else 1)] for op in OPS}
    assert {x.dtype for arrays in found.values() for x in arrays} == {np.dtype("float64")}
    return found


def blocks(op, arrays, values, repeated):
    """What is compared as one: outputs; gradients by the parameters, and by their logarithms."""
    if op not in GRADIENTS:
        return arrays
    m, k, *_ = values[7:] if op is ops.PopulationGradient else values
    mass, stiffness, rayleigh, ratios = (np.asarray(x) for x in arrays)
    ratios = ratios.sum(axis=-1) if repeated else ratios
    return [mass, stiffness, m * mass, k * stiffness, rayleigh[..., 0], rayleigh[..., 1], ratios]


def errors(got, expected, values, repeated=False):
    """Largest error over the largest value of each Op's blocks, by name; shapes and NaN must agree."""
    worst = {}
    for op in expected:
        for a, b in zip(got[op], expected[op], strict=True):
            assert a.shape == b.shape
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        pairs = zip(*(blocks(op, x[op], values, repeated) for x in (got, expected)), strict=True)
        sizes = [(np.nan_to_num(abs(a - b)).max(), np.nan_to_num(abs(b)).max()) for a, b in pairs]
        worst[op.__name__] = max(error / max(size, 1e-300) for error, size in sizes)
    return worst


def compare(settings, values, repeated=False):
    got, expected = (results(mode, settings, values) for mode in ("JAX", PLAIN))
    return errors(got, expected, values, repeated)


@pytest.mark.parametrize("damping", [name for name in DAMPINGS if name != "light"])
@pytest.mark.parametrize("settings", SETTINGS)
def test_all_ops_agree_with_the_kernels(settings, damping, quick_compilation):
    """Values, reverse and forward derivatives, alone and in populations: measured 2e-13."""
    found = compare(settings, values_of(settings, damping))
    assert max(found.values()) < LIMIT, found


@pytest.mark.parametrize("damping", ["none", "rayleigh", "heavy", "equal", "critical"])
@pytest.mark.parametrize("case", REPEATED)
def test_all_ops_agree_at_repeated_frequencies(case, damping, quick_compilation):
    """Damping ratios of the pair are moved together: which mode is which is up to the eigen-solver."""
    settings, mass, stiffness, limit = REPEATED[case]
    found = compare(settings, values_of(settings, damping, mass, stiffness), repeated=True)
    assert max(found.values()) < limit, found


@pytest.mark.parametrize(
    ("damping", "stiffness"),
    [
        ("none", [1e4, 1e6, 1e8]),  # omega h from 1 to 300
        ("overdamped", [1e3, 1e5, 1e7]),
        ("unequal", [1e3, 1e-2, 500.0]),  # equal frequencies, each with a damping of its own
    ],
)
def test_all_ops_agree_at_the_edges(damping, stiffness, quick_compilation):
    """Steps far longer than a period, and modes that are close but not to be taken for one: 2e-10."""
    values = values_of("3 masses", damping, [1.0] * 3, stiffness)
    got, expected = (results(mode, "3 masses", values) for mode in ("JAX", PLAIN))
    found = errors(got, expected, values)
    assert max(found.values()) < 10 * LIMIT, found


def impossible(i, wrong):
    """Values with one wrong number in parameter i: of the one structure, and of the last particle."""
    values = values_of("3 masses", "equal")
    for k in (i, 7 + i):
        values[k] = values[k].copy()
        values[k][..., -1][(-1,) * (values[k].ndim - 1)] = wrong
    return values


@pytest.mark.parametrize("i", range(4), ids=list(CHAIN.inputs)[:4])
@pytest.mark.parametrize("wrong", [-1.0, np.nan, np.inf])
def test_impossible_structures_are_nan(i, wrong, quick_compilation):
    """As in the kernels: of a population that particle alone, and the gradients by what all share."""
    values = impossible(i, wrong)
    got, expected = (results(mode, "3 masses", values) for mode in ("JAX", PLAIN))
    for tangent in TANGENTS:
        del expected[tangent]
    assert max(errors(got, expected, values).values()) < LIMIT
    assert all(np.isnan(x).all() for op in expected if op.__name__[:5] == "Chain" for x in got[op])
    assert np.isnan(got[ops.PopulationDiscrepancy][0][-1]).all()
    assert i in (0, 3) or np.isfinite(got[ops.PopulationDiscrepancy][0][:-1]).all()


def test_tangents_of_impossible_structures_are_nan(quick_compilation):
    """Forward mode, too, must not pass for a number."""
    values = impossible(0, -1.0)
    got, expected = (results(mode, "3 masses", values) for mode in ("JAX", PLAIN))
    for tangent in TANGENTS:
        assert np.isnan(expected[tangent][0]).all()
        assert np.isnan(got[tangent][0]).all()


# --------------------------------------------------------------------------- negative controls


@pytest.mark.parametrize(("name", "value"), [("CLOSE", 1e-30), ("TAYLOR_TERMS", 6)])
def test_wrong_coefficients_are_seen(name, value, monkeypatch, quick_compilation):
    """Negative control: quotients at nearly equal frequencies, or a short Taylor series, do not agree."""
    inputs, outputs = graph("absolute_acceleration", 1, 1, 3)
    mine = outputs[OPS.index(ops.MisfitGradient) + 3 :][:4]  # behind a gradient of four outputs
    assert {x.owner.op for x in mine} == {ops.MisfitGradient()}
    values = values_of("3 masses", "equal", *REPEATED["soft 1e-09"][1:3])
    expected = {ops.MisfitGradient: results(PLAIN, "3 masses", values)[ops.MisfitGradient]}
    results("JAX", "3 masses", values)  # registers the dispatch
    monkeypatch.setattr(sys.modules["pymc_features.ops.jax_dispatch.modes"], name, value)
    got = pytensor.function(inputs, mine, mode="JAX", on_unused_input="ignore")(*values)
    [error] = errors({ops.MisfitGradient: got}, expected, values, repeated=True).values()
    assert error > 10 * LIMIT


def test_derivatives_of_eigenvectors_fail_where_ours_do_not():
    """Negative control: jax.grad through jnp.linalg.eigh is right, except at repeated frequencies."""

    def displacement(k):  # after 0.1 s from a unit velocity of all masses
        matrix = jnp.diag(k + jnp.append(k[1:], 0.0)) - jnp.diag(k[1:], 1) - jnp.diag(k[1:], -1)
        squares, shapes = jnp.linalg.eigh(matrix)
        return (shapes @ (jnp.sin(0.1 * jnp.sqrt(squares)) / jnp.sqrt(squares) * shapes.sum(axis=0)))[0]

    with jax.enable_x64(True):
        apart, repeated = (jax.grad(displacement)(jnp.array([1e3, s, 500.0])) for s in (100.0, 1e-297))
        h = np.array([0.0, 1e-3, 0.0])
        k = np.array([1e3, 100.0, 500.0])
        slope = (displacement(jnp.array(k + h)) - displacement(jnp.array(k - h))) / 2e-3
    np.testing.assert_allclose(apart[1], slope, rtol=1e-6)
    assert not np.isfinite(repeated).all()
    values = values_of("3 masses", "equal", *REPEATED["soft 1e-300"][1:3])
    ours = results("JAX", "3 masses", values)
    assert all(np.isfinite(x).all() for op in GRADIENTS for x in ours[op])


# --------------------------------------------------------------------------- batches and settings

RECORD = noise_record(N_TIMES)

MEASURED = with_noise(simulate(three_storeys(100.0), RECORD))


@pytest.mark.parametrize("what", ["discrepancy", "response"])
def test_batches(what, quick_compilation):
    """vectorize_graph: discrepancies go to the population Op, responses to `Blockwise`."""
    stiffness, batch = pt.vector("k", shape=(3,)), pt.matrix("batch", shape=(None, 3))
    y = response(three_storeys(stiffness), RECORD)
    y = pmf.mean_square_discrepancy(y, MEASURED) if what == "discrepancy" else y
    y = vectorize_graph(y, {stiffness: batch})
    numbers = np.random.default_rng(6).uniform(20.0, 400.0, (4, 3))
    got, expected = (
        pytensor.function([batch], [y, pt.grad((y**2).sum(), batch)], mode=mode)(numbers)
        for mode in ("JAX", PLAIN)
    )
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=LIMIT, atol=1e-15)


# --------------------------------------------------------------------------- log-densities of models


def model_of(likelihood, dt=None):
    """Unknown theta, which may be negative, and sigma; the output step is data where it is given."""
    with pm.Model() as model:
        theta, sigma = pm.Normal("theta", 1.0, 0.3), pm.HalfNormal("sigma", 2.0)
        step = None if dt is None else pm.Data("step", dt)
        measured = pm.Data("measured", every(dt or RECORD.dt))
        mu = response(with_first_spring(theta), RECORD, dt=step)
        likelihood("y", mu=mu, sigma=sigma, observed=measured)
    return model


def every(dt):
    return MEASURED[:, :: round(dt / RECORD.dt)]


def log_density(model):
    """Of the unconstrained parameters, in JAX."""
    from pymc.sampling.jax import get_jaxified_logp

    return get_jaxified_logp(model)


def by_pymc(model, points):
    """Log-densities, and their gradients (point, parameter)."""
    outputs = [model.logp(), model.dlogp()]
    function = model.compile_fn(outputs, inputs=model.value_vars, mode="FAST_COMPILE", point_fn=False)
    pairs = [function(*point) for point in zip(*points, strict=True)]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


POINTS = [np.random.default_rng(4).normal(mean, 0.2, 7) for mean in (1.0, 0.0)]  # theta, ln sigma

CORRELATED = functools.partial(pmf.CorrelatedNormal, correlation_time=0.1)
HEAVY_TAILS = functools.partial(pm.StudentT, nu=4.0)  # needs the response itself; the others are fused


@pytest.mark.parametrize(
    "likelihood", [pmf.TruncNormalFeature, pmf.ExpFeature, CORRELATED, pm.Normal, HEAVY_TAILS]
)
def test_log_densities_of_models(likelihood, request):
    """jax.grad and jax.vmap: seven points as by PyMC, one by one; an eighth, impossible, harms none.

    The first with all optimisations of XLA.
    """
    if likelihood is not pmf.TruncNormalFeature:
        request.getfixturevalue("quick_compilation")
    model = model_of(likelihood)
    points = [np.append(POINTS[0], -1.0), np.append(POINTS[1], 0.0)]
    logp, gradients = jax.jit(jax.vmap(jax.value_and_grad(log_density(model))))(points)
    assert logp.dtype == gradients[0].dtype == np.float64
    expected, slopes = by_pymc(model, POINTS)
    np.testing.assert_allclose(logp[:7], expected, rtol=LIMIT)
    np.testing.assert_allclose(np.stack(gradients, axis=1)[:7], slopes, rtol=LIMIT)
    assert np.isneginf(logp[7]) or np.isnan(logp[7])


def test_on_the_first_device(quick_compilation):
    """A GPU where JAX has one, else the processor: there, in double precision, point by point."""
    density = jax.jit(jax.value_and_grad(log_density(model_of(pmf.TruncNormalFeature))))
    device = jax.devices()[0]
    assert device.platform == jax.default_backend()
    expected, slopes = by_pymc(model_of(pmf.TruncNormalFeature), POINTS)
    for point, value, slope in zip(zip(*POINTS, strict=True), expected, slopes, strict=True):
        logp, gradient = density(jax.device_put([np.array(x) for x in point], device))
        assert all(x.devices() == {device} and x.dtype == np.float64 for x in (logp, *gradient))
        np.testing.assert_allclose([logp, *gradient], [value, *slope], rtol=LIMIT)


def test_gradient_by_the_data(quick_compilation):
    """Data that are no numbers, such as a record with unknown offset, count."""
    with pm.Model() as model:
        offset = pm.Flat("offset")
        mu = response(three_storeys(100.0), RECORD)
        pm.Potential("misfit", pmf.mean_square_discrepancy(mu, MEASURED + offset).sum())
    _, [[expected]] = by_pymc(model, [[0.5]])
    [gradient] = jax.jit(jax.grad(log_density(model)))([np.array(0.5)])
    assert gradient == pytest.approx(expected, rel=LIMIT)


@pytest.mark.filterwarnings("ignore:The RandomType SharedVariables")  # PyTensor copies generators for JAX
def test_correlated_draws():
    """Covariance of 20000 draws within five standard errors; a false alarm in 6000 seeds."""
    k = np.arange(23)
    y = pmf.CorrelatedNormal.dist(np.zeros((2, 23)), [1.0, 2.0], [0.2, 0.01], 0.02, size=(20_000, 2))
    draws = pm.draw(y, random_seed=1, mode="JAX")
    for j, (sigma, tau) in enumerate([(1.0, 0.2), (2.0, 0.01)]):
        found = draws[:, j].T @ draws[:, j] / 20_000 / sigma**2
        for longer in (1.0, 1.3):  # the second is a negative control
            expected = np.exp(-np.abs(k - k[:, None]) * 0.02 / (longer * tau))
            worst = (np.abs(found - expected) / np.sqrt((1.0 + expected**2) / 20_000)).max()
            assert (worst < 5.0) == (longer == 1.0)


# --------------------------------------------------------------------------- the output step as data


def test_output_step_as_data(quick_compilation):
    """For samplers PyMC makes it a number; a function that could change it is refused."""
    model = model_of(pmf.TruncNormalFeature, dt=0.04)
    for dt in (0.04, 0.1):
        with model:
            pm.set_data({"step": dt, "measured": every(dt)})
        expected, slopes = by_pymc(model, [x[:1] for x in POINTS])
        logp, gradient = jax.jit(jax.value_and_grad(log_density(model)))([x[0] for x in POINTS])
        np.testing.assert_allclose([logp, *gradient], [expected[0], *slopes[0]], rtol=LIMIT)
    with pytest.raises(NotImplementedError, match="fixed when it compiles.*Pass `dt` to response"):
        model.compile_logp(mode="JAX")


# --------------------------------------------------------------------------- samplers

SAMPLERS = {
    "default": {},  # nutpie by Numba, where it is installed
    "pymc": {"nuts_sampler": "pymc"},
    "nutpie": {"nuts_sampler": "nutpie", "backend": "jax", "compile_kwargs": {"gradient_backend": "jax"}},
    "numpyro": {"nuts_sampler": "numpyro", "nuts": {"chain_method": "vectorized"}},
}


@pytest.fixture(scope="module")
def one_stiffness():
    """TN for three storeys: the model, and the exact mean and standard deviation of theta."""

    def total(theta):
        misfit = simulate(three_storeys(100.0 * theta), RECORD).values - MEASURED
        return float((misfit**2).mean(axis=1).sum())

    with pm.Model() as model:
        mu = response(three_storeys(100.0 * pm.Uniform("theta", *paper.THETA_RANGE)), RECORD)
        pmf.TruncNormalFeature("y", mu=mu, sigma=pm.Uniform("sigma", *paper.SIGMA_RANGE), observed=MEASURED)
    curve = quadrature.DiscrepancyCurve(total, paper.THETA_RANGE, MEASURED.size)
    exponents = LIKELIHOODS["TN"].exponents(*MEASURED.shape)
    exact = quadrature.exact_posterior(curve, exponents, paper.SIGMA_RANGE)
    nodes, below = exact.theta.nodes, exact.theta.below
    middle, probability = 0.5 * (nodes[1:] + nodes[:-1]), np.diff(below)
    mean = probability @ middle
    return model, mean, np.sqrt(probability @ (middle - mean) ** 2)


@pytest.mark.default_mode
@pytest.mark.statistical
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_samplers_find_the_posterior(sampler, one_stiffness, quick_compilation):
    """Mean and sd of theta within 5 Monte Carlo errors of the quadrature; false alarms: below 1e-4 in all."""
    model, mean, sd = one_stiffness
    quiet = {"progressbar": False, "compute_convergence_checks": False, "cores": 1, "random_seed": 1}
    idata = pm.sample(200, tune=200, chains=2, model=model, **quiet, **SAMPLERS[sampler])
    theta = idata["posterior"]["theta"].values
    assert theta.shape == (2, 200)
    assert az.ess(theta) > 100
    assert abs(theta.mean() - mean) < 5 * az.mcse(theta)
    assert abs(theta.std() - sd) < 5 * az.mcse(theta, method="sd")
    assert abs(theta.mean() - (mean + sd)) > 5 * az.mcse(theta)  # negative control: one sd beside


# --------------------------------------------------------------------------- JAX is imported late

LATE = """
    import sys
    import numpy as np
    from pymc_features import ModalDamping, SpringMassChain, response
    from support.straight import Record
    import pytensor, pytensor.tensor as pt
    k = pt.dscalar("k")
    y = response(SpringMassChain([1.0, 2.0], k, ModalDamping(0.1)), Record([0.0, 1.0, 0.0], 0.1))
    dispatch = "pymc_features.ops.jax_dispatch"
    expected = pytensor.function([k], y, mode=pytensor.compile.mode.Mode(linker="py", optimizer=None))(9.0)
    assert "jax" not in sys.modules
    import jax
    assert jax.numpy.ones(1).dtype == "float32" and dispatch not in sys.modules
    got = pytensor.function([k], y, mode="JAX")(9.0)
    assert dispatch in sys.modules
    assert got.dtype == "float64"
    np.testing.assert_allclose(got, expected, rtol=1e-14, atol=1e-15)
    print("done")
"""


@pytest.mark.processes
def test_dispatch_is_registered_when_a_graph_is_compiled_for_jax(tmp_path):
    """Not with the package; in double precision also if JAX was in use, in single precision, before."""
    assert run_python(LATE, tmp_path) == "done"


@pytest.mark.parametrize("stiff", [3e5, 1e11])
@pytest.mark.parametrize("quantity", ["absolute_acceleration", "relative_velocity"])
def test_modes_that_follow_their_input(quantity, stiff, quick_compilation):
    """A spring so stiff that its mode is not stepped: response and gradient as by the kernels."""
    record = pmf.Record(noise_record(N_TIMES).acceleration, 0.02)
    theta = pt.vector("theta")
    chain = pmf.SpringMassChain(
        [1.0, 2.0, 1.5], theta[:3] * np.array([1e3, stiff, 800.0]), pmf.RayleighDamping(0.2, 1e-4 * theta[3])
    )
    mu = response(chain, record, quantity=quantity)
    weights = np.random.default_rng(0).normal(size=(3, N_TIMES))
    outputs = [mu, pt.grad((weights * mu).sum(), theta)]
    at = np.array([1.1, 0.9, 1.0, 1.2])
    found, expected = (pytensor.function([theta], outputs, mode=m)(at) for m in ("JAX", PLAIN))
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-6, atol=1e-8 * np.abs(other).max())
