"""Kernels of linear structures: against matrix exponentials without modes, complex steps, and each other."""

import numpy as np
import pytest

from pymc_features.simulators import FAMILIES
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


POPULATIONS = [
    *("coupled, quantity 0", "coupled, forces", "classical, quantity 0", "classical, quantity 3"),
    *("classical, two supports", "classical, sparse", "classical, substeps", "classical, stride"),
    *("classical, rigid body", "classical, repeated", "classical, repeated rigid bodies"),
    *("classical, truncated", "classical, forces", "ratios, truncated"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", POPULATIONS)
def test_population_is_its_particles(name):
    """More than a vector of them; what is shared has the sum of the gradients; bad rows alone are NaN.

    Of parameters that keep frequencies in pairs, and of those that part them.
    """
    case, _ = CASES[name]
    rng, count = np.random.default_rng(5), LANES + 3
    _, rayleigh, ratios = case.parameters
    theta = case.theta + ("repeated" not in name) * rng.uniform(0.0, 0.5, (count, case.theta.size))
    rayleigh = np.tile(rayleigh, (count, 1)) * rng.uniform(0.5, 1.5, (count, 1))
    if "supports" in name:  # shared
        rayleigh = rayleigh[:1]
    observed = rng.normal(size=linear_response(*case.arguments).shape)
    weights = rng.uniform(size=(count, 3, 4))
    rows = theta, rayleigh, ratios[None], *case.rest, observed
    each = [(theta[p], rayleigh[p % len(rayleigh)], ratios, *rows[3:]) for p in range(count)]
    expected = np.array([linear_misfit(*one) for one in each])
    np.testing.assert_allclose(linear_population_misfit(*rows), expected, rtol=1e-9, atol=1e-10)
    errors = linear_population_discrepancy(*rows)
    np.testing.assert_allclose(errors, expected[:, :, 0], rtol=1e-10)

    given = LINEAR.assemble(rows[:-2], case.quantity)
    of_all = FAMILIES["linear"].kernels["population_gradient"](*given, observed, weights)
    of_errors = linear_population_gradient(*rows, weights[:, :, 0])
    for found, c in ((of_all, weights), (of_errors, weights[:, :, :1])):
        slopes = [linear_misfit_gradient(*one, w) for one, w in zip(each, c, strict=True)]
        for i in range(2 + ratios.any()):
            exact = np.array([slope[i] for slope in slopes])
            exact = exact if len(rows[i]) > 1 else exact.sum(axis=0, keepdims=True)
            np.testing.assert_allclose(found[i], exact, rtol=0, atol=1e-8 * abs(exact).max())

    theta[1], theta[LANES] = np.nan, -1e3
    bad = linear_population_discrepancy(*rows)
    np.testing.assert_array_equal(np.isnan(bad).all(axis=1), np.isin(np.arange(count), [1, LANES]))
    np.testing.assert_allclose(np.delete(bad, [1, LANES], axis=0), np.delete(errors, [1, LANES], axis=0))


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
