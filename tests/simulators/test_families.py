"""Every family of structures through the same Ops: fused, batched, differentiated, sampled."""

import pickle

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph

from pymc_features import (
    AffineStructure,
    DiscrepancySimulator,
    LinearStructure,
    TruncNormalFeature,
    fisher_information,
    mean_square_discrepancy,
    response,
    sample_smc,
    simulate,
)
from pymc_features.ops import OPS, PopulationDiscrepancy, StructuralDiscrepancy, misfit_statistics
from pymc_features.ops.comparison import misfit_values
from pymc_features.ops.response import response_step
from pymc_features.simulators import FAMILIES
from pymc_features.structures import STRUCTURES
from pymc_features.structures.specimens import SPECIMENS
from support.families import CASES, CYCLIC, RAYLEIGH, TRUTH, K, measured, pulse
from support.graphs import PLAIN, our_ops
from support.reference import richardson
from support.sampling import SERIAL


def test_every_structure_is_in_a_family_and_here():
    assert {kind.family for kind in (*STRUCTURES, *SPECIMENS)} == set(FAMILIES)
    built = {build(TRUTH).family for build, _ in (CASES | CYCLIC).values()}
    assert built == set(FAMILIES)
    for family in FAMILIES.values():
        may_lack = {"population_systems", "gradient_systems", "gradient_of_sums"}
        may_lack |= {"discrepancy_gradient", "history"}
        assert set(family.kernels) - may_lack == {op.kernel_name for op in OPS}


@pytest.mark.parametrize("name", CASES)
def test_response_is_simulate(name):
    build, record = CASES[name]
    x, some = pt.vector("x", shape=(2,)), {"dt": 0.025, "sensors": [2, 0]}
    for quantity, options in (
        ("absolute_acceleration", some),
        ("relative_displacement", some),
        ("base_shear", {}),
    ):
        mu = response(build(x), record, quantity=quantity, **options)
        expected = np.atleast_2d(simulate(build(TRUTH), record, quantity=quantity, **options).values)
        if options:
            assert mu.type.shape == expected.shape and mu.dtype == "float64"
            assert response_step(mu) == pytest.approx(0.025, rel=1e-14)
        found = mu.eval({x: TRUTH}, mode=PLAIN)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES | CYCLIC)
def test_fused_is_unfused_and_batch_is_loop(name):
    """And the gradients of both are differences."""
    build, record = (CASES | CYCLIC)[name]
    data, x, rows = measured(name), pt.vector("x", shape=(2,)), pt.matrix("rows", shape=(None, 2))
    mu = response(build(x), record)
    e, statistics = mean_square_discrepancy(mu, data), misfit_statistics(mu, data)
    plain = [pt.mean(pt.sqr(data - mu), axis=-1), misfit_values(data - mu)]
    batch = vectorize_graph([e, statistics], {x: rows})
    assert our_ops([e]) == {StructuralDiscrepancy}
    assert our_ops(batch[:1]) == {PopulationDiscrepancy}
    one = pytensor.function([x], [e, statistics, *plain], mode=PLAIN)
    all_rows = pytensor.function([rows], batch, mode=PLAIN)
    # more than one vector of particles, one of them no structure
    points = np.random.default_rng(1).uniform(0.7, 1.3, (11, 2))
    points[4, 0] = -3.0
    batched = all_rows(points)
    for i, point in enumerate(points):
        fused = one(point)
        rtol, atol = 1e-10, 1e-12
        if name in ("hysteretic", "duffing"):  # histories take other steps, right to 1e-6 of the peak
            rtol, atol = 2e-6, 1e-6
        for a, b in ((fused[0], fused[2]), (fused[1], fused[3])):
            np.testing.assert_allclose(a, b, rtol=rtol, atol=atol * abs(data).max() ** 2)
        if name == "coupled damping":  # complex modes that settle in lanes, right to 2e-11 of the peak
            rtol, atol = 1e-9, 2e-11
        for a, b in ((batched[0][i], fused[0]), (batched[1][i], fused[1])):
            np.testing.assert_allclose(a, b, rtol=rtol, atol=atol * abs(data).max() ** 2)
    assert np.isnan(batched[0][4]).all()
    assert np.isfinite(np.delete(batched[0], 4, axis=0)).all()

    weights = np.array([1.0, -2.0, 0.5])[: len(data)]
    total = pt.dot(weights, e)
    of_all = pt.grad(vectorize_graph(total, {x: rows}).sum(), rows)
    gradient, gradients = (
        pytensor.function([v], g, mode=PLAIN) for v, g in ((x, pt.grad(total, x)), (rows, of_all))
    )
    points = np.array([[1.05, 0.9], [0.8, 1.2]])
    expected = np.array(
        [[richardson(lambda v: weights @ one(v)[0], p, d) for d in np.eye(2)] for p in points]
    )
    error = (2e-5 if name == "hysteretic" else 2e-6) * abs(expected).max()  # steps that are chosen jump
    np.testing.assert_allclose([gradient(p) for p in points], expected, rtol=0, atol=error)
    np.testing.assert_allclose(gradients(points), expected, rtol=0, atol=error)


@pytest.mark.slow
@pytest.mark.parametrize("name", ("coupled damping", "hysteretic", *CYCLIC))
def test_numba_runs_the_same_and_keeps_its_code(name):
    build, record = (CASES | CYCLIC)[name]
    data, x, rows = measured(name), pt.vector("x", shape=(2,)), pt.matrix("rows", shape=(None, 2))
    e = mean_square_discrepancy(response(build(x), record), data)
    outputs = [e, vectorize_graph(e, {x: rows}), *pytensor.gradient.grad(e.sum(), [x])]
    inputs = TRUTH * 1.1, np.array([TRUTH, [0.8, 1.1]])
    compiled = pytensor.function([x, rows], outputs, mode="NUMBA")
    plain = pytensor.function([x, rows], outputs, mode=PLAIN)
    for got, expected in zip(compiled(*inputs), plain(*inputs), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9)


def model_of(name, likelihood=TruncNormalFeature):
    build, record = (CASES | CYCLIC)[name]
    data = measured(name)
    with pm.Model(coords={"sensor": range(len(data)), "time": np.arange(data.shape[1])}) as model:
        # below zero there is no structure, whatever the family; specimens that yield at once take many steps
        x = pm.Uniform("x", [-0.4, 0.3 if name in CYCLIC else -0.4], 1.6, shape=2)
        sigma = pm.Uniform("sigma", 0.0, 3.0)
        likelihood("y", response(build(x), record), sigma, observed=data, dims=("sensor", "time"))
    return model


@pytest.mark.slow
@pytest.mark.parametrize("name", ("chain", "coupled damping", "hysteretic", *CYCLIC))
def test_models_sample_and_count_what_is_no_structure(name):
    """After pickling, with NUTS, information and predictions."""
    model = model_of(name)
    again, point = pickle.loads(cloudpickle.dumps(model)), model.initial_point()
    assert again.compile_logp(mode=PLAIN)(point) == model.compile_logp(mode=PLAIN)(point)
    with model:
        assert isinstance(pm.NUTS(mode="FAST_COMPILE"), pm.NUTS)
    information = fisher_information(model, {"x": TRUTH, "sigma": 0.3})["information"].values
    assert (np.linalg.eigvalsh(information) > 0).all()
    with pm.Model():
        build, record = (CASES | CYCLIC)[name]
        x = pm.Uniform("x", 0.7, 1.3, shape=2)
        y = DiscrepancySimulator("y", response(build(x), record), epsilon=1.0, observed=measured(name))
    draw = pm.draw(y, random_seed=1, mode=PLAIN)
    assert draw.shape == measured(name).shape and np.isfinite(draw).all()
    quick = {"compile_kwargs": {"mode": "FAST_COMPILE"}, **SERIAL}
    idata = sample_smc(40, model=model, chains=1, random_seed=1, **quick)
    assert float(idata["sample_stats"]["failed"].sum()) > 0
    x = idata["posterior"]["x"].values
    assert (x > 0).all()
    assert abs(np.median(x, axis=(0, 1)) - 1.0).max() < 0.4


def test_combinations_are_fused_where_the_structure_is_linear():
    build, record = CASES["chain"]
    x = pt.vector("x", shape=(2,))
    S = np.array([[1.0, -0.5, 0.0], [0.0, 0.0, 2.0]])
    for structure in ("chain", "affine", "coupled damping", "hysteretic"):
        build = CASES[structure][0]
        drifts = response(build(x), record, outputs=S, quantity="relative_displacement")
        expected = simulate(build(TRUTH), record, outputs=S, quantity="relative_displacement").values
        np.testing.assert_allclose(
            drifts.eval({x: TRUTH}, mode=PLAIN), expected, rtol=0, atol=1e-12 * abs(expected).max()
        )
        e = mean_square_discrepancy(drifts, expected)
        fused = {StructuralDiscrepancy} <= our_ops([e])
        assert fused == (structure != "hysteretic")


def test_uncertain_masses_of_a_linear_structure():
    record = pulse()
    mass = pt.vector("mass", shape=(3,))
    loads = [np.diag(unit) for unit in np.eye(3)]
    frame = AffineStructure(np.zeros((3, 3)), stiffness=K, damping=RAYLEIGH, mass_terms=loads, theta=mass)
    values = np.array([1.0, 2.0, 0.7])
    for quantity in ("absolute_acceleration", "base_shear"):
        got = response(frame, record, quantity=quantity).eval({mass: values}, mode=PLAIN)
        expected = simulate(
            LinearStructure(values, stiffness=K, damping=RAYLEIGH), record, quantity=quantity
        ).values
        np.testing.assert_allclose(got, np.atleast_2d(expected), rtol=0, atol=1e-11 * abs(expected).max())
