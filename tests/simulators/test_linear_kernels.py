"""Kernels of linear structures: against matrix exponentials without modes, complex steps, and each other."""

import copy

import numpy as np
import pytest
from scipy import sparse

from pymc_features import (
    LinearStructure,
    simulate,
)
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.linear import gradient
from pymc_features.simulators.linear import response as population
from pymc_features.simulators.linear.system import is_coupled
from pymc_features.simulators.numbers.vectors import LANES
from support.kernels import (
    linear_discrepancy,
    linear_discrepancy_gradient,
    linear_discrepancy_tangent,
    linear_misfit,
    linear_misfit_gradient,
    linear_population_discrepancy,
    linear_population_gradient,
    linear_population_misfit,
    linear_response,
    linear_response_gradient,
    linear_response_tangent,
)
from support.linear_cases import CASES, LINEAR, random_case, split
from support.reference import misfit_statistics
from support.straight import Record
from support.structures import peak_error


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_response_and_derivatives(name):
    """Response, statistics of misfits, gradients and, to 1e-6, differences along a direction."""
    case, accuracy = CASES[name]
    rng = np.random.default_rng(1)
    parameters, arguments = case.parameters, case.arguments
    expected = case.reference(np.concatenate(parameters))
    response = linear_response(*arguments)
    assert peak_error(response, expected) < 1e-11
    directions, derivatives = case.derivatives()
    used = len(directions)

    weights = rng.normal(size=response.shape)
    gradient = np.concatenate(linear_response_gradient(*arguments, weights))
    found = directions @ gradient
    assert peak_error(found, (derivatives * weights).sum(axis=(1, 2))) < accuracy
    if case.damping:
        assert not gradient[used:].any()

    observed = expected + 0.3 * np.abs(expected).max() * rng.normal(size=expected.shape)
    statistics = misfit_statistics(observed - expected)
    np.testing.assert_allclose(linear_misfit(*arguments, observed), statistics, rtol=1e-11)
    np.testing.assert_allclose(linear_discrepancy(*arguments, observed), statistics[:, 0], rtol=1e-11)
    of_statistics = rng.uniform(1.0, 2.0, statistics.shape)
    found = directions @ np.concatenate(linear_misfit_gradient(*arguments, observed, of_statistics))
    # quadratic in the response: central differences of any step have no error
    up, down = (misfit_statistics(observed - expected - step * derivatives) for step in (0.01, -0.01))
    assert peak_error(found, ((up - down) / 0.02 * of_statistics).sum(axis=(1, 2))) < accuracy
    per_sensor = rng.uniform(1.0, 2.0, expected.shape[0])
    by_response = 2.0 * ((expected - observed) * derivatives).mean(axis=2)
    of_errors = np.concatenate(linear_discrepancy_gradient(*arguments, observed, per_sensor))
    assert peak_error(directions @ of_errors, by_response @ per_sensor) < accuracy

    share = np.abs(rng.normal(size=used))  # free bodies are held and linked: one side is a structure
    direction = share @ directions
    moved = linear_response_tangent(*arguments, *split(direction, parameters))
    assert peak_error(moved, np.tensordot(share, derivatives, axes=1)) < 1e-6
    moved_errors = linear_discrepancy_tangent(*arguments, observed, *split(direction, parameters))
    assert peak_error(moved_errors, share @ by_response) < 1e-6


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("total", [1, 128, 129])
@pytest.mark.parametrize(("substeps", "stride"), [(1, 1), (2, 1), (1, 200)])
def test_gradient_of_the_misfit_across_blocks(total, substeps, stride, coupled):
    """Records that end before, at and behind the border of a block of 128 steps, by the whole cotangent."""
    n_times = -(-(total - 1) * stride // substeps) + 1
    case = random_case(21, 3, coupled=coupled, grid=(substeps, stride), n_times=n_times)
    rng, response = np.random.default_rng(22), linear_response(*case.arguments)
    misfit, weights, n = rng.normal(size=response.shape), rng.normal(size=(3, 4)), response.shape[1]
    increments = np.diff(misfit, axis=1, prepend=misfit[:, :1], append=misfit[:, -1:])
    cotangent = -2.0 / n * (weights[:, :1] * misfit - weights[:, 1:2] * np.diff(increments, axis=1))
    cotangent[:, 0] -= weights[:, 2]
    cotangent[:, -1] -= weights[:, 3]
    expected = np.concatenate(linear_response_gradient(*case.arguments, cotangent))
    found = np.concatenate(linear_misfit_gradient(*case.arguments, response + misfit, weights))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max() + 1e-14)


@pytest.mark.parametrize("name", ["coupled, quantity 0", "classical, two supports", "classical, sparse"])
def test_population_is_its_particles(name):
    """Those that share theta, or not; what is shared gets the sum of the gradients; the bad one is NaN."""
    case, _ = CASES[name]
    rng = np.random.default_rng(5)
    _, rayleigh, ratios = case.parameters
    theta = rng.uniform(0.2, 1.0, (6, 3))
    observed = rng.normal(size=linear_response(*case.arguments).shape)
    weights = rng.uniform(size=(6, 3))
    population = theta, rayleigh[None], ratios[None], *case.rest, observed
    each = [(row, rayleigh, ratios, *case.rest, observed) for row in theta]
    expected = np.array([linear_misfit(*one) for one in each])
    np.testing.assert_allclose(linear_population_misfit(*population), expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(linear_population_discrepancy(*population), expected[:, :, 0], rtol=1e-11)
    gradients = [linear_discrepancy_gradient(*one, c) for one, c in zip(each, weights, strict=True)]
    found = linear_population_gradient(*population, weights)
    assert peak_error(found[0], [g[0] for g in gradients]) < 1e-12
    np.testing.assert_allclose(found[1], sum(g[1] for g in gradients)[None], rtol=1e-10)
    theta[2] = -20.0
    bad = linear_population_discrepancy(*population)
    assert np.isnan(bad[2]).all() and np.isfinite(np.delete(bad, 2, axis=0)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "varied"),
    [
        ("classical, quantity 0", [1, 1, 1]),
        ("classical, quantity 3", [1, 1, 1]),
        ("classical, substeps", [1, 1, 1]),
        ("classical, rigid body", [1, 1, 1]),
        ("classical, repeated", [0, 1, 0]),  # what keeps the frequencies in pairs
        ("classical, repeated rigid bodies", [1, 0]),
        ("classical, truncated", [1, 1, 1]),
        ("ratios, truncated", [0, 1, 1]),
    ],
)
def test_dense_population_is_compiled(name, varied, monkeypatch):
    """Misfits of more than two vectors of particles, without our modes; NaN in the bad rows alone."""
    monkeypatch.setattr(population, "solved", None)
    case, _ = CASES[name]
    rng = np.random.default_rng(19)
    count = 2 * LANES + 5
    theta = case.theta + varied * rng.uniform(0.0, 0.5, (count, len(varied)))
    rayleigh = case.rayleigh * rng.uniform(0.5, 1.5, (count, 2))
    good = np.setdiff1d(np.arange(count), [1, LANES, LANES + 2, LANES + 3])
    responses = np.array(
        [case.reference(np.concatenate([theta[p], rayleigh[p], case.ratios])) for p in range(count)]
    )
    theta[1], theta[LANES], theta[LANES + 2], rayleigh[LANES + 3, 0] = np.nan, -50.0, 1e308, -40.0
    observed = rng.normal(size=responses[0].shape) * np.abs(responses[0]).max()
    expected = misfit_statistics(observed - responses)
    rows = theta, rayleigh, case.ratios[None], *case.rest, observed
    found = linear_population_misfit(*rows)
    assert np.isnan(np.delete(found, good, axis=0)).all()
    for k in range(4):
        assert peak_error(found[good, :, k], expected[good, :, k]) < 1e-10
    errors = linear_population_discrepancy(*rows)
    assert errors.shape == found.shape[:2] and np.isnan(np.delete(errors, good, axis=0)).all()
    np.testing.assert_allclose(errors[good], found[good, :, 0], rtol=1e-13)
    shared = linear_population_discrepancy(theta[:1], rayleigh[:2], *rows[2:])
    by_one = case.reference(np.concatenate([theta[0], rayleigh[1], case.ratios]))
    assert peak_error(shared[0], errors[0]) < 1e-13
    assert peak_error(shared[1], ((observed - by_one) ** 2).mean(axis=1)) < 1e-10


@pytest.mark.parametrize(
    ("name", "shared"),
    [
        ("classical, quantity 0", "nothing"),
        ("classical, stride", "theta"),
        ("classical, two supports", "ratios and rayleigh"),
        ("classical, rigid body", "theta"),
        ("classical, repeated", "nothing"),
        ("classical, forces", "nothing"),
        ("ratios, truncated", "nothing"),
    ],
)
def test_dense_gradients_are_compiled(name, shared, monkeypatch):
    """Without our modes, of all statistics; NaN in the bad rows, and in what they share with the others."""
    monkeypatch.setattr(gradient, "solved", None)
    case, accuracy = copy.copy(CASES[name][0]), CASES[name][1]
    rng = np.random.default_rng(23)
    counts = [1 if given in shared else 5 for given in ("theta", "rayleigh", "ratios")]
    rows = [np.tile(a, (count, 1)) for a, count in zip(case.parameters, counts, strict=True)]
    rows[1] *= rng.uniform(0.8, 1.2, (counts[1], 1))
    if name != "classical, repeated":
        rows[0] *= rng.uniform(0.8, 1.2, (counts[0], 1))
    response = linear_response(*case.arguments)
    observed, weights = rng.normal(size=response.shape), rng.uniform(size=(5, *response.shape[:1], 4))
    expected = [np.zeros(a.shape) for a in rows]
    for p in range(5):
        case.theta, case.rayleigh, _ = (a[p % len(a)] for a in rows)
        directions, derivatives = case.derivatives()
        misfit = observed - case.reference(np.concatenate(case.parameters))
        up, down = (misfit_statistics(misfit - step * derivatives) for step in (0.01, -0.01))
        slopes = ((up - down) / 0.02 * weights[p]).sum(axis=(1, 2)) / directions.max(axis=1)
        for total, part in zip(expected, split(np.pad(slopes, (0, 9)), case.parameters), strict=True):
            total[p % len(total)] += part[: total.shape[1]]

    def found():
        given = LINEAR.assemble((*rows, *case.rest[:-1]), case.quantity)
        return FAMILIES["linear"].kernels["population_gradient"](*given, observed, weights)

    for got, exact in zip(found()[: 2 + case.ratios.any()], expected, strict=False):
        assert peak_error(got, exact) < accuracy
    spoilt = rows[0] if len(rows[0]) > 1 else rows[1]
    spoilt[[1, 3]] = [[np.nan], [-1e4]]
    for got in found()[:2]:
        bad = [p in (1, 3) or len(got) == 1 for p in range(len(got))]
        np.testing.assert_array_equal(np.isnan(got).all(axis=1), bad)


@pytest.mark.parametrize("name", ["classical, two supports", "coupled, two supports", "classical, sparse"])
def test_sparse_outputs(name):
    case, _ = CASES[name]
    thin = case.arguments_with(sensors=sparse.csr_array(case.sensors))
    assert peak_error(linear_response(*thin), linear_response(*case.arguments)) < 1e-13


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize(
    ("coupled", "name", "value"),
    [
        (False, "theta", [np.nan, 0.0, 0.0]),
        (False, "theta", [1e308, 1e308, 1e308]),
        (False, "theta", [-30.0, 0.0, 0.0]),  # M
        (False, "theta", [0.0, -30.0, 0.0]),  # K
        (False, "rayleigh", [-10.0, 0.0]),
        (False, "rayleigh", [np.inf, 0.0]),
        (False, "ratios", [-0.5]),
        (True, "theta", [0.0, -4.0, 0.0]),  # C
        (True, "theta", [np.inf, 0.0, 0.0]),
    ],
)
def test_no_structure_gives_nan(coupled, name, value, large):
    """Never an exception; and the same shapes as ever. Dense, and sparse with few modes."""
    size = dict(n=9, n_modes=3, is_sparse=True) if large else dict(n=4)
    case = random_case(15, coupled=coupled, **size)
    case.stiffness[1] *= 0.0  # the first parameter is of M alone
    if coupled:
        case.stiffness[2] *= 0.0  # and the second of C
    good, (observed, weights) = case.arguments, (np.zeros((3, 120)), np.ones(3))
    own = [
        np.resize(value, a.size) if key == name else a
        for key, a in zip(("theta", "rayleigh", "ratios"), case.parameters, strict=True)
    ]
    bad = *own, *case.rest
    rows = tuple(np.array(a)[None] for a in own)
    for kernel, more in (
        (linear_response, ()),
        (linear_discrepancy, (observed,)),
        (linear_misfit, (observed,)),
        (linear_response_gradient, (observed,)),
        (linear_discrepancy_gradient, (observed, weights)),
        (linear_response_tangent, case.parameters),
        (linear_discrepancy_tangent, (observed, *case.parameters)),
    ):
        found, usual = kernel(*bad, *more), kernel(*good, *more)
        if not isinstance(found, tuple):
            found, usual = (found,), (usual,)
        assert all(np.isnan(a).all() and a.shape == b.shape for a, b in zip(found, usual, strict=True))
        assert all(np.isfinite(b).all() for b in usual)
    assert np.isnan(linear_population_discrepancy(*rows, *case.rest, observed)).all()
    assert np.isnan(linear_population_misfit(*rows, *case.rest, observed)).all()
    for sums in linear_population_gradient(*rows, *case.rest, observed, weights[None]):
        assert np.isnan(sums).all()


def test_sizes_that_disagree():
    case = random_case(16, 4)
    good, stiffness = case.arguments, case.named()["stiffness"]
    for change, match in (
        (dict(theta=np.zeros(2)), "`mass` must have shape"),
        (dict(stiffness=stiffness[:, 1:]), "`stiffness` must have shape"),
        (dict(starts=np.zeros(5, dtype=int)), "`rows` and `starts` must be the pattern"),
        (dict(forces=np.zeros((4, 2))), "`influence` and `forces` must have shape"),
        (dict(acceleration=case.inputs[0]), "`influence` and `forces` must have shape|not enough"),
        (dict(sensors=np.eye(3)), "`sensors` must have one column"),
        (dict(n_modes=5), "`n_modes` must lie between 1"),
        (dict(ratios=np.zeros(3)), "`rayleigh` must have 2 values, and `ratios` one for each mode kept"),
    ):
        with pytest.raises((ValueError, IndexError), match=match):
            linear_response(*case.arguments_with(**change))
    observed, weights = np.zeros((3, 120)), np.ones(3)
    with pytest.raises(ValueError, match="must have the shape .sensor, time. of the response"):
        linear_discrepancy(*good, observed[:, 1:])
    with pytest.raises(ValueError, match="`weights` must have one value or four for each sensor"):
        linear_discrepancy_gradient(*good, observed, weights[1:])
    with pytest.raises(ValueError, match="the directions must have the shapes of the parameters"):
        linear_response_tangent(*good, np.zeros(2), np.zeros(2), np.zeros(4))
    rows = np.zeros((2, 3)), np.zeros((3, 2)), np.zeros((1, 4))
    with pytest.raises(ValueError, match="the parameters must have one row, or one for each particle"):
        linear_population_discrepancy(*rows, *case.rest, observed)
    with pytest.raises(ValueError, match="and `weights` all rows"):
        linear_population_gradient(rows[0], *(a[:1] for a in rows[1:]), *case.rest, observed, weights[None])


def test_simulate_and_the_kernel_are_one():
    """Of a damping matrix that couples the modes, and of one that does not."""
    case = random_case(18, 4, coupled=True, n_modes=3)
    for damping in (case.damping[0], 0.1 * case.mass[0]):
        structure = LinearStructure(case.mass[0], stiffness=case.stiffness[0], damping=damping)
        record = Record(case.inputs[0], case.dt)
        expected = simulate(structure, record, n_modes=3, dt=0.06)
        found = linear_response(
            *(*structure.parameters(), *structure.constants(record), structure.excitation(record)),
            *(record.dt, 1, 2, np.eye(4), 3, 0),
        )
        assert is_coupled(structure.modal_damping()) == (damping is case.damping[0])
        assert peak_error(found, expected) < 1e-13
