"""Kernels of linear structures: against matrix exponentials without modes, complex steps, and each other."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh_tridiagonal

from pymc_features import (
    AffineStructure,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    simulate,
)
from pymc_features.algebra import natural_modes
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear import gradient
from pymc_features.simulators.linear import response as population
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.dense import dense_modes
from pymc_features.simulators.linear.oscillators import pull_back
from pymc_features.simulators.linear.projection import invert_outside, to_parameters
from pymc_features.simulators.linear.system import is_coupled, solve_system
from support import kernels
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
from support.linear_cases import CASES, LINEAR, definite, random_case, split, springs
from support.reference import first_order_hold, misfit_statistics
from support.straight import Loading, Record
from support.structures import peak_error

MISFIT_CASES = [
    "coupled, quantity 0",
    "coupled, quantity 3",
    "coupled, two supports",
    "coupled, stride",
    "coupled, substeps",
    "coupled, truncated, sparse",
    "classical, quantity 0",
    "classical, two supports",
    "classical, stride",
    "classical, truncated, sparse",
    "ratios",
]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_response_and_derivatives(name):
    """Response, gradients and, to 1e-6, differences along a direction, which are their transposes."""
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


@pytest.mark.parametrize("name", ["classical, stride", "coupled, stride", "classical, two supports"])
def test_misfits_are_those_of_the_response(name):
    case, _ = CASES[name]
    response = linear_response(*case.arguments)
    observed = np.random.default_rng(2).normal(size=response.shape)
    expected = misfit_statistics(observed - response)
    np.testing.assert_allclose(linear_misfit(*case.arguments, observed), expected, rtol=1e-11)
    np.testing.assert_allclose(linear_discrepancy(*case.arguments, observed), expected[:, 0], rtol=1e-12)


@pytest.mark.parametrize("name", MISFIT_CASES)
def test_gradient_of_the_misfit(name):
    """All four statistics by the derivatives of the response without our modes; e_j alone by one column."""
    case, accuracy = CASES[name]
    rng = np.random.default_rng(20)
    expected = case.reference(np.concatenate(case.parameters))
    observed = expected + 0.3 * np.abs(expected).max() * rng.normal(size=expected.shape)
    weights = rng.uniform(1.0, 2.0, (expected.shape[0], 4))
    directions, derivatives = case.derivatives()
    # the statistics are quadratic in the response: central differences of any step have no error
    up, down = (misfit_statistics(observed - expected - step * derivatives) for step in (0.01, -0.01))
    slopes = (up - down) / 0.02 * weights
    for columns in (4, 1):
        found = linear_misfit_gradient(*case.arguments, observed, weights[:, :columns])
        by_response = slopes[..., :columns].sum(axis=(1, 2))
        assert peak_error(directions @ np.concatenate(found), by_response) < accuracy


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("total", [1, 2, 128, 129, 257])
@pytest.mark.parametrize(("substeps", "stride"), [(1, 1), (1, 3), (2, 1), (1, 200)])
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


# --------------------------------------------------------------------------- the chain is a member


def chain_arguments(n, kind, ratios):
    """A chain by its kernels and by K(theta) = sum_i k_i K_i and M(theta) = sum_i m_i M_i, theta = (k, m)."""
    rng = np.random.default_rng(n)
    mass, stiffness = rng.uniform(1.0, 2.0, n), rng.uniform(500.0, 2000.0, n)
    zero = np.zeros((n, n))
    terms = [kind(springs(n, row)) for row in np.eye(n)], [kind(np.diag(row)) for row in np.eye(n)]
    structure = AffineStructure(
        kind(zero),
        stiffness=kind(zero),
        damping=ModalDamping(ratios),
        stiffness_terms=[*terms[0], *[None] * n],
        mass_terms=[*[None] * n, *terms[1]],
        theta=np.concatenate([stiffness, mass]),
    )
    record = Record(rng.normal(size=400), 0.02)
    rayleigh = np.array([0.2, 1e-3])
    asked = record.dt, 1, 1
    sensors = np.array([0, n - 1])
    chain = (mass, stiffness, rayleigh, ratios), (record.acceleration, *asked, sensors)
    linear = (
        (structure.theta, rayleigh, ratios),
        (*structure.constants(record), structure.excitation(record), *asked, np.eye(n)[sensors]),
    )
    return chain, linear


@pytest.mark.parametrize("quantity", range(4))
@pytest.mark.parametrize("n_modes", [5, 2])
def test_kernels_of_the_chain(n_modes, quantity):
    """Response, misfits and gradients to 1e-10 or better, differences along a direction to 1e-7."""
    rng = np.random.default_rng(3)
    kind = sparse.csc_array if n_modes == 2 else np.asarray
    (own, chain_rest), (parameters, rest) = chain_arguments(5, kind, np.linspace(0.01, 0.05, 5))
    chain = *own, *chain_rest, n_modes, quantity
    linear = *parameters, *rest, n_modes, quantity
    expected = kernels.chain_response(*chain)
    assert peak_error(linear_response(*linear), expected) < 1e-12
    observed = expected + np.abs(expected).max() * rng.normal(size=expected.shape)
    found = linear_misfit(*linear, observed)
    np.testing.assert_allclose(found, kernels.chain_misfit(*chain, observed), rtol=1e-11)
    weights = rng.uniform(size=2)
    mass, stiffness, rayleigh, ratios = kernels.discrepancy_gradient(*chain, observed, weights)
    theta, *damping = linear_discrepancy_gradient(*linear, observed, weights)
    for one, other in zip((theta, *damping), (np.append(stiffness, mass), rayleigh, ratios), strict=True):
        assert peak_error(one, other) < 1e-10
    d_mass, d_stiffness, d_rayleigh, d_ratios = (rng.normal(size=a.size) * a for a in own)
    expected = kernels.response_tangent(*chain, d_mass, d_stiffness, d_rayleigh, d_ratios)
    moved = linear_response_tangent(*linear, np.append(d_stiffness, d_mass), d_rayleigh, d_ratios)
    assert peak_error(moved, expected) < 1e-7


# --------------------------------------------------------------------------- populations


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


# --------------------------------------------------------------------------- dense and compiled as a whole


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "varied"),
    [
        *((f"classical, quantity {q}", [1, 1, 1]) for q in range(4)),
        ("classical, substeps", [1, 1, 1]),
        ("classical, stride", [1, 1, 1]),
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


DENSE_GRADIENTS = [
    *(f"classical, quantity {q}" for q in range(4)),
    *("classical, substeps", "classical, stride", "classical, two supports", "classical, rigid body"),
    *("classical, repeated", "classical, constant mass", "classical, forces"),
    *("classical, truncated", "ratios, truncated"),
]


@pytest.mark.parametrize("shared", ["nothing", "theta", "ratios and rayleigh"])
@pytest.mark.parametrize("n_weights", [1, 4])
@pytest.mark.parametrize("name", DENSE_GRADIENTS)
def test_dense_gradients_are_compiled(name, n_weights, shared, monkeypatch):
    """Those of the modes in Python, particle by particle; NaN in the bad rows, and in what is shared."""
    case, _ = CASES[name]
    assert not case.damping and not case.is_sparse
    rng = np.random.default_rng(23)
    observed = rng.normal(size=linear_response(*case.arguments).shape)
    weights = rng.uniform(size=(7, observed.shape[0], n_weights))
    counts = [1 if given in shared else 7 for given in ("theta", "rayleigh", "ratios")]
    theta, rayleigh, ratios = (
        np.tile(own, (count, 1)) * rng.uniform(0.8, 1.2, (count, 1))
        for own, count in zip(case.parameters, counts, strict=True)
    )

    def loop():
        sums = tuple(np.zeros(a.shape) for a in (theta, rayleigh, ratios))
        for p in range(7):
            own = [a[p % len(a)] for a in (theta, rayleigh, ratios)]
            a = Arguments(*LINEAR.assemble((*own, *case.rest[:-1]), case.quantity))
            system = solve_system(a, left_out=True)
            if system is None:
                found = [np.full(part.shape, np.nan) for part in own]
            else:
                found = to_parameters(a, system, pull_back(a, system, observed, weights[p]))
            for total, part in zip(sums, found, strict=True):
                total[p % len(total)] += part
        return sums

    for spoil in (False, True):
        if spoil:
            one = theta if len(theta) > 1 else rayleigh
            one[[2, 4]] = [[np.nan], [-1e4]]
        expected = loop()
        with monkeypatch.context() as patch:
            patch.setattr(gradient, "solved", None)
            found = FAMILIES["linear"].kernels["population_gradient"](
                *LINEAR.assemble((theta, rayleigh, ratios, *case.rest[:-1]), case.quantity), observed, weights
            )
        for got, exact in zip(found, expected, strict=True):
            np.testing.assert_array_equal(np.isnan(got), np.isnan(exact))
            good = ~np.isnan(exact)
            scale = abs(exact[good]).max(initial=0.0)
            np.testing.assert_allclose(got[good], exact[good], rtol=0, atol=1e-10 * scale)
        assert np.isnan(found[0]).any() == np.isnan(found[1]).any() == spoil


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("n_modes", [12, 5])
def test_compiled_modes(full, free, n_modes):
    """Those of `algebra.natural_modes`, signs included; rigid bodies at zero exactly."""
    rng = np.random.default_rng(20)
    mass = np.diag(10.0 ** rng.uniform(-3.0, 3.0, 12)) + full * definite(rng, 12, 1.0)
    stiffness = springs(12, rng.uniform(1e3, 1e6, 12 - free), free=free)
    omega, shapes = np.empty(n_modes), np.empty((n_modes, 12))
    assert dense_modes(mass, stiffness, omega, shapes)
    expected, columns = natural_modes(mass, stiffness, n_modes)
    np.testing.assert_allclose(omega, expected, rtol=1e-10)
    assert (omega == 0.0).sum() == free
    root = np.sqrt(np.diag(mass))
    assert peak_error(shapes * root, columns.T * root) < 1e-9


@pytest.mark.parametrize(
    ("mass", "stiffness"),
    [
        (np.full((2, 2), np.nan), np.eye(2)),
        (np.eye(2), np.array([[1.0, np.inf], [np.inf, 1.0]])),
        (np.diag([1.0, -1.0]), np.eye(2)),
        (np.diag([1.0, 0.0]), np.diag([1.0, 0.0])),  # neither mass nor stiffness
        (np.diag([0.0, 0.0]), np.eye(2)),
        (np.array([[1.0, 1.0], [1.0, 0.0]]), 100.0 * np.eye(2)),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), 100.0 * np.eye(2)),  # an eigenvalue of -1
        (np.eye(2), np.array([[1.0, 1.1], [1.1, 1.0]])),
        (1e-200 * np.eye(2), 1e200 * np.eye(2)),  # omega^2 overflows
        (1e-200 * np.array([[2.0, 1.0], [1.0, 2.0]]), 1e200 * np.eye(2)),
    ],
)
def test_no_compiled_modes(mass, stiffness):
    assert not dense_modes(mass, stiffness, np.empty(2), np.empty((2, 2)))


@pytest.mark.parametrize("name", ["classical, two supports", "coupled, two supports", "classical, sparse"])
def test_sparse_outputs(name):
    case, _ = CASES[name]
    thin = case.arguments_with(sensors=sparse.csr_array(case.sensors))
    assert peak_error(linear_response(*thin), linear_response(*case.arguments)) < 1e-13


# --------------------------------------------------------------------------- what is no structure


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


# --------------------------------------------------------------------------- large and sparse


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [False, True])
def test_twenty_modes_of_two_thousand(coupled):
    """Against a banded eigen-solver and a matrix exponential: response to 1e-8, tangent, transpose."""
    n, kept, k = 2000, 20, 1e8
    rng = np.random.default_rng(6)
    zones = np.arange(n) * 4 // n
    drifts = sparse.diags_array([np.ones(n), -np.ones(n - 1)], offsets=[0, -1]).tocsc()
    terms = [(drifts.T @ sparse.diags_array(np.where(zones == z, k, 0.0)) @ drifts).tocsc() for z in range(4)]
    theta = np.array([1.0, 0.9, 1.1, 0.8])
    top = sparse.coo_array(([200.0], ([n - 1], [n - 1])), shape=(n, n))
    damping = (0.5 * sparse.eye_array(n) + top).tocsc() if coupled else RayleighDamping(0.5, 0.0)
    structure = AffineStructure(
        np.ones(n), stiffness=sparse.csc_array((n, n)), damping=damping, stiffness_terms=terms, theta=theta
    )
    record = Record(rng.normal(size=300), 0.02)
    sensors = np.array([300, 999, 1999])
    drag = np.full(n, 0.5)
    drag[-1] += 200.0 * coupled

    def reference(values):
        spring = k * values[zones]
        above = np.append(spring[1:], 0.0)
        lowest, shapes = eigh_tridiagonal(spring + above, -spring[1:], select="i", select_range=(0, kept - 1))
        own_drag = shapes.T @ (drag[:, None] * shapes)
        system = own_drag, np.diag(lowest), -shapes.T @ np.ones((n, 1))
        relative = first_order_hold(*system, record.acceleration[None], record.dt)[2]
        return shapes[sensors] @ relative + record.acceleration

    _, rayleigh, ratios = structure.parameters()
    arguments = (
        *(theta, rayleigh, ratios[:kept], *structure.constants(record), structure.excitation(record)),
        *(record.dt, 1, 1, np.eye(n)[sensors], kept, 0),
    )
    expected = reference(theta)
    assert peak_error(linear_response(*arguments), expected) < 1e-8
    direction, step = rng.normal(size=4), 1e-4
    expected = (
        8.0 * (reference(theta + step * direction) - reference(theta - step * direction))
        - (reference(theta + 2 * step * direction) - reference(theta - 2 * step * direction))
    ) / (12.0 * step)
    zeros = np.zeros(2), np.zeros(kept)
    moved = linear_response_tangent(*arguments, direction, *zeros)
    assert peak_error(moved, expected) < 1e-6
    weights = rng.normal(size=moved.shape)
    gradient = linear_response_gradient(*arguments, weights)[0]
    assert (weights * moved).sum() == pytest.approx(direction @ gradient, rel=1e-6)


@pytest.mark.parametrize("free", [False, True])
def test_complement_of_sparse_and_dense_modes(free):
    """Conjugate gradients and all modes say the same of modes left out, behind a gap or not."""
    dense = random_case(17, 30, free=free, constant_mass=True, n_modes=4)
    thin = random_case(17, 30, free=free, constant_mass=True, n_modes=4, is_sparse=True)
    loads = np.random.default_rng(7).normal(size=(30, 4))
    by_modes = solve_system(dense.grouped(), left_out=True)
    by_factor = solve_system(thin.grouped(), left_out=True)
    signs = np.sign((by_modes.shapes * (by_modes.mass @ by_factor.shapes)).sum(axis=0))
    assert peak_error(by_factor.shapes * signs, by_modes.shapes) < 1e-9 and by_factor.others is None
    assert peak_error(invert_outside(by_factor, loads), invert_outside(by_modes, loads)) < 1e-9


# --------------------------------------------------------------------------- what structures say


def test_constants_of_structures():
    """One pattern for M, C and K; only A_0 where nothing depends on theta; loads of both kinds."""
    stiffness = sparse.csc_array(springs(4, 100.0))
    dashpot = sparse.csc_array(np.diag([0.0, 0.0, 0.0, 2.0]))
    structure = AffineStructure(
        np.ones(4),
        stiffness=stiffness,
        damping=0.1 * stiffness,
        stiffness_terms=[dashpot],
        influence=np.eye(4)[:, :2],
    )
    record = Loading(np.ones((2, 5)), 0.1)
    mass, damping, spring, rows, starts, influence, forces = structure.constants(record)
    assert mass.shape == damping.shape == (1, rows.size) and spring.shape == (2, rows.size)
    assert starts.tolist() == [0, 2, 5, 8, 10] and influence.shape == forces.shape == (4, 2)
    assert not forces.any() and structure.excitation(record).shape == (2, 5)
    assert mass[0].sum() == 4.0 and spring[1].sum() == 2.0
    assert structure.matrices()[0].nnz == 4  # of the common pattern only what is not zero
    push = Loading(np.ones(5), 0.1, kind="force", matrix=np.ones((4, 1)))
    *_, influence, forces = structure.constants(push)
    assert not influence.any() and forces.tolist() == [[1.0]] * 4
    plain = LinearStructure(np.ones(2), stiffness=np.eye(2), damping=ModalDamping(0.1))
    mass, damping, _, rows, starts, *_ = plain.constants(Record([0.0, 1.0], 0.1))
    assert mass.shape == (1, 4) and damping.shape == (0, 4) and rows.size == starts.size == 0
    assert [a.size for a in plain.parameters()] == [0, 2, 2]
    chain = SpringMassChain([1.0], 1.0, ModalDamping(0.1))
    assert chain.constants(record) == () and chain.excitation(Record([0.0, 1.0], 0.1)).tolist() == [0.0, 1.0]
    with pytest.raises(TypeError, match="`record` must be a Record for a SpringMassChain, got Loading"):
        chain.excitation(record)


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
