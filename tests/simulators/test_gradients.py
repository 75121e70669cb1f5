"""First derivatives of response and discrepancy: against complex steps, in graphs, in models."""

import numpy as np
import pytest

from pymc_features.simulators import FAMILIES
from support.kernels import (
    DAMPINGS,
    chain_response,
    discrepancy_gradient,
    discrepancy_tangent,
    population_gradient,
    response_gradient,
    response_tangent,
)
from support.random_chains import population, random_chain
from support.reference import first_order_hold, interpolated

CHAIN = FAMILIES["chain"]
TINY = 1e-30  # complex step, relative: its square is nothing beside one


def square_root(matrix):
    """Principal root by Denman and Beavers: complex steps pass, at repeated eigenvalues too."""
    scale = np.trace(matrix).real
    root, inverse = matrix / scale, np.eye(len(matrix))
    for _ in range(60):
        root, inverse = 0.5 * (root + np.linalg.inv(inverse)), 0.5 * (inverse + np.linalg.inv(root))
    return root * np.sqrt(scale)


def eigenpairs(matrix):
    """Of a symmetric matrix, by Newton steps: complex steps pass, but not at repeated eigenvalues."""
    n = len(matrix)
    values, vectors = (x.astype(complex) for x in np.linalg.eigh(matrix.real))
    for r in range(n):
        for _ in range(2):
            x, residual = vectors[:, r], matrix @ vectors[:, r] - values[r] * vectors[:, r]
            border = np.block([[matrix - values[r] * np.eye(n), -x[:, None]], [-x, np.zeros(1)]])
            change = np.linalg.solve(border, np.append(-residual, 0.5 * (x @ x - 1.0)))
            vectors[:, r], values[r] = x + change[:n], values[r] + change[n]
    return values, vectors


def state_space(mass, stiffness, rayleigh, ratios, n_modes, by_modes=False):
    """Stiffness and damping matrix, load and 1/sqrt(m), in the coordinates M^(1/2) u."""
    n, above = len(mass), np.append(stiffness[1:], 0.0)
    scale = 1.0 / np.sqrt(mass)
    springs = np.diag(stiffness + above) - np.diag(stiffness[1:], 1) - np.diag(stiffness[1:], -1)
    springs = scale[:, None] * springs * scale
    damping, load = rayleigh[0] * np.eye(n) + rayleigh[1] * springs, np.sqrt(mass)
    if n_modes < n or by_modes or np.ptp(ratios.real) > 0 or np.abs(ratios - ratios[0]).max() > 0:
        values, vectors = eigenpairs(springs)
        damping = damping + 2.0 * vectors * (ratios * np.sqrt(values)) @ vectors.T
        kept = vectors[:, :n_modes]
        load = kept @ (kept.T @ load)
        if by_modes:
            springs = vectors * values @ vectors.T
    elif ratios[0]:
        damping = damping + 2.0 * ratios[0] * square_root(springs)
    return springs, damping, load, scale


def march(systems, ground, step, stride, quantity, sensors):
    """Histories (system, sensor, time) by first-order hold with matrix exponentials."""
    springs, damping, load, scale = (np.stack(x) for x in zip(*systems, strict=True))
    u, v, relative = first_order_hold(damping, springs, -load[..., None], ground[None], step, stride)
    u, v, relative = (scale[..., None] * x for x in (u, v, relative))
    return (relative + ground[::stride], relative, v, u)[quantity][:, sensors]


def directions(arguments, common=False):
    """Steps (direction, parameter) of the logarithm of each mass, spring, alpha, beta and ratio.

    Parameters that are zero take a step themselves; `common` moves all ratios at once.
    """
    flat, n = np.concatenate(arguments[:4]), arguments[0].size
    steps = np.diag(np.where(flat == 0.0, 1.0, flat))
    return np.vstack([steps[:-n], steps[-n:].sum(axis=0)]) if common else steps


def split(row):
    """Mass, stiffness, rayleigh and ratios out of one row."""
    n = (row.size - 2) // 3
    return np.split(row, [n, 2 * n, 2 * n + 2])


def complex_steps(arguments, steps, by_modes=False):
    """Response (sensor, time), and its derivative (direction, sensor, time) along each direction."""
    *parameters, acceleration, dt, substeps, stride, _, sensors, n_modes, quantity = arguments
    stepped = np.concatenate(parameters) + 1j * TINY * steps
    systems = [state_space(*split(row), n_modes, by_modes) for row in stepped]
    [ground] = interpolated(acceleration[None], substeps)
    histories = march(systems, ground, dt / substeps, stride, quantity, sensors)
    return histories[0].real, histories.imag / TINY


def soft_middle(softness):
    """Two parts of one frequency each, sqrt(1000) rad/s, which a soft spring joins."""
    return {"mass": np.ones(3), "stiffness": np.array([1000.0, 1000.0 * softness, 500.0])}


def tuned_absorber(share):
    """A small mass on a large one, tuned to its frequency."""
    return {"mass": np.array([1.0, share]), "stiffness": 1000.0 * np.array([1.0, share])}


def wilkinson(n):
    """The chain of Wilkinson's matrix W+ (plus 2): eigenvalues in ever closer pairs, no soft spring."""
    matrix = np.diag(np.abs(np.arange(n) - n // 2) + 2.0)
    matrix -= np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    root = np.linalg.solve(matrix, np.eye(n)[0])  # of the masses: only the first is tied to the base
    springs = 100.0 * root[1:] * root[:-1]
    return {
        "mass": root**2,
        "stiffness": np.append(100.0 * matrix[0, 0] * root[0] ** 2 - springs[0], springs),
    }


def block_error(actual, expected, n, size=None):
    """Largest error over the largest value, or `size`, of mass, stiffness, alpha, beta, ratios."""
    arrays = (actual - expected, expected if size is None else size)
    blocks = zip(*(np.split(x, np.cumsum([n, n, 1, 1])) for x in arrays), strict=True)
    return max(np.abs(d).max(initial=0.0) / np.abs(e).max(initial=1e-300) for d, e in blocks)


def errors(arguments, steps, by_modes=False):
    """Relative errors of the response and of its gradients."""
    n, rng = arguments[0].size, np.random.default_rng(5)
    y, slopes = complex_steps(arguments, steps, by_modes)
    weights, c = rng.normal(size=y.shape), rng.normal(size=y.shape[0])
    observed = y + 0.3 * np.abs(y).max() * rng.normal(size=y.shape)
    e_slopes = 2.0 / y.shape[1] * np.sum((y - observed) * slopes, axis=-1)
    backward = steps @ np.concatenate(response_gradient(*arguments, weights))
    e_backward = steps @ np.concatenate(discrepancy_gradient(*arguments, observed, c))
    rows = [np.tile(x, (3, 1)) for x in arguments[:4]]  # three go together in a vector
    together = population_gradient(*rows, *arguments[4:], observed, np.tile(c, (3, 1)))
    e_together = steps @ np.concatenate([x[1] for x in together])
    return {
        "response": np.abs(chain_response(*arguments) - y).max() / np.abs(y).max(),
        "response_gradient": block_error(backward, np.tensordot(slopes, weights, 2), n),
        "discrepancy_gradient": block_error(e_backward, e_slopes @ c, n, np.abs(e_slopes) @ np.abs(c)),
        "population_gradient": block_error(e_together, e_slopes @ c, n, np.abs(e_slopes) @ np.abs(c)),
    }


def assert_right(arguments, limit, steps=None):
    found = errors(arguments, directions(arguments) if steps is None else steps)
    assert max(found.values()) < limit, found


def case(n, damping="rayleigh", quantity=0, limit=5e-11, **changes):
    return n, damping, quantity, limit, changes


SIZES = {1: 300, 2: 2, 5: 129, 13: 140, 30: 140}  # masses: samples
CASES = {
    **{f"{n} masses": case(n, limit=2e-11, n_times=n_times) for n, n_times in SIZES.items()},
    **{f"{damping} damping": case(5, damping, i % 4) for i, damping in enumerate(DAMPINGS)},
    **{f"truncated, quantity {q}": case(5, "unequal", q, n_modes=q + 1) for q in range(4)},
    "truncated, equal damping": case(5, "equal", n_modes=2),
    "coarse": case(4, "unequal", 0, stride=5, sensors=np.array([1, 1, 2])),
    "coarse velocity": case(4, "unequal", 2, stride=2, sensors=np.array([2])),
    "fine": case(4, "unequal", 2, substeps=10, sensors=np.array([3, 0])),
    "close modes of unequal damping": case(
        3, limit=1e-8, ratios=np.array([0.9, 1.0, 1.1]), **soft_middle(3e-5)
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_against_complex_steps(name):
    """Measured 1e-11 at most; 7e-11 where dampings of close modes differ, and the quotient is taken."""
    n, damping, quantity, limit, changes = CASES[name]
    assert_right(random_chain(n, damping, quantity, **changes), limit)


CLOSE_PAIRS = {
    **{f"soft {e:g}": soft_middle(e) for e in (1e-2, 2e-5, 1e-6, 1e-10, 1e-12)},
    **{f"absorber {e:g}": tuned_absorber(e) for e in (1e-2, 3e-7, 1e-8, 1e-10)},
    "Wilkinson": wilkinson(11),
}


@pytest.mark.slow
@pytest.mark.parametrize("damping", ["none", "rayleigh", "heavy", "equal", "critical"])
@pytest.mark.parametrize("case", CLOSE_PAIRS)
def test_repeated_frequencies(case, damping):
    """Right to 1e-7 however close two modes come, which no formula with eigenvectors is: measured 7e-8."""
    changes = CLOSE_PAIRS[case]
    arguments = random_chain(changes["mass"].size, damping, **changes)
    assert_right(arguments, 1e-7, directions(arguments, common=True))


def test_exactly_repeated_frequencies():
    """A spring of 1e-297 N/m, two equal eigenvalues: measured 2e-13."""
    for quantity in range(4):
        arguments = random_chain(3, "rayleigh", quantity, **soft_middle(1e-300))
        assert_right(arguments, 1e-12, directions(arguments)[:-3])


def test_eigenvector_derivatives_fail_at_repeated_frequencies():
    """Negative control: derivatives mode by mode are right where frequencies are apart only."""
    worst = []
    for softness in (0.1, 1e-6, 1e-10):
        arguments = random_chain(3, **soft_middle(softness))
        worst.append(max(errors(arguments, directions(arguments, common=True), by_modes=True).values()))
    assert worst[0] < 1e-10
    assert worst[1] > 1e-6
    assert worst[2] > 0.1


@pytest.mark.parametrize(
    ("softness", "scale", "beta", "ratio"),
    [(1e-3, 1.0, 0.0, 3.0), (1e-2, 1.0, 0.0, 30.0), (3e-2, 1.0, 10.0, 0.0), (3e-2, 1e-9, 0.0, 0.05)],
)
def test_close_modes_with_short_memory(softness, scale, beta, ratio):
    """Overdamped modes, and a record far shorter than the period: phases part little, the dampings differ."""
    damping = {"rayleigh": np.array([0.0, beta]), "ratios": np.full(3, ratio)}
    arguments = random_chain(3, **soft_middle(softness), **damping)
    arguments[1] *= scale
    assert_right(arguments, 1e-7, directions(arguments, common=True))


@pytest.mark.parametrize("case", [{}, {"n_modes": 2}, {"stride": 3, "sensors": np.array([2, 0])}], ids=str)
@pytest.mark.parametrize("quantity", [0, 3])
def test_forward_is_the_transpose_of_reverse(case, quantity):
    """<W, J d> = <J' W, d>, of differences to 1e-7, and to 1e-6 where two modes are kept of close ones.

    Shapes of modes 1e-9 apart, one of them left out, turn within a step of the differences (error 2e-3). All
    ratios change alike: where they do not, the response jumps from one of two close modes to the other.
    """
    rng = np.random.default_rng(quantity)
    for softness in (1.0, 1e-5) if "n_modes" in case else (1.0, 1e-5, 1e-9):
        changes = soft_middle(softness) if softness < 1.0 else {}
        error = 1e-6 if changes and "n_modes" in case else 1e-7
        arguments = random_chain(3, "equal", quantity, **changes, **case)
        y = chain_response(*arguments)
        observed, weights, c = y + rng.normal(size=y.shape), rng.normal(size=y.shape), rng.normal(size=len(y))
        d = np.concatenate(arguments[:4]) * rng.normal(size=11)
        d[-3:] = arguments[3] * rng.normal()
        terms = weights * response_tangent(*arguments, *split(d))
        back = np.concatenate(response_gradient(*arguments, weights)) * d
        assert abs(terms.sum() - back.sum()) < error * (np.abs(terms).sum() + np.abs(back).sum())
        terms = c * discrepancy_tangent(*arguments, observed, *split(d))
        back = np.concatenate(discrepancy_gradient(*arguments, observed, c)) * d
        assert abs(terms.sum() - back.sum()) < error * (np.abs(terms).sum() + np.abs(back).sum())


def each_alone(arguments, observed, c):
    """Gradients of the particles of a population, one after the other; what is shared gets the sum."""
    sums = [np.zeros(x.shape) for x in arguments[:4]]
    for p, weights in enumerate(c):
        own = [x[p % len(x)] for x in arguments[:4]]
        gradients = discrepancy_gradient(*own, *arguments[4:], observed, weights)
        for total, gradient in zip(sums, gradients, strict=True):
            total[p % len(total)] += gradient
    return sums


@pytest.mark.parametrize("shared", [(), (0,), (0, 2, 3)], ids=str)
def test_gradient_of_a_population(shared):
    arguments, observed, c = population(shared)
    for a, b in zip(
        population_gradient(*arguments, observed, c), each_alone(arguments, observed, c), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14 * np.abs(b).max())


@pytest.mark.parametrize(("damping", "dt"), [("none", 0.5), ("rayleigh", 0.02), ("none", 1e-5)])
def test_modes_beside_multiples_of_half_the_sampling_rate(damping, dt):
    """Of one storey, omega dt = 0, pi, 2 pi and 3 pi to 1e-3 ... 1e-9, and slow modes: measured 1e-11."""
    away = np.array([0.3, 1e-3, -1e-3, 1e-6, 1e-9])
    phases = np.concatenate([np.pi * k + (away if k else np.abs(away)) for k in range(4)])
    arguments = random_chain(1, damping)
    for i in range(4):
        arguments[i] = np.tile(arguments[i], (phases.size, 1))
    arguments[0], arguments[1], arguments[5] = arguments[0] ** 0, (phases[:, None] / dt) ** 2, dt
    arguments[2] *= [1.0, dt]
    observed, c = np.random.default_rng(11).normal(size=(1, 150)), np.ones((phases.size, 1))
    found = population_gradient(*arguments, observed, c)
    for a, b in zip(found, each_alone(arguments, observed, c), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10)


def test_gaps_and_close_modes_within_a_vector():
    """A chain with close modes goes by itself; its neighbours, and samples that are missing, stay right."""
    rng = np.random.default_rng(12)
    arguments = random_chain(3, quantity=1, sensors=np.array([2, 0, 1]))
    for i in range(4):
        arguments[i] = arguments[i] * rng.uniform(0.8, 1.2, (11, arguments[i].size))
    for p, softness in ((1, 1e-8), (9, 1e-10)):
        close = soft_middle(softness)
        arguments[0][p], arguments[1][p] = close["mass"], close["stiffness"]
    observed, c = rng.normal(size=(3, 150)), rng.normal(size=(11, 3))
    observed[0, 10:30], observed[2, 140:] = np.nan, np.nan
    for a, b in zip(
        population_gradient(*arguments, observed, c), each_alone(arguments, observed, c), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())


INVALID = {
    "mass": [1.0, -1.0, 1.0],
    "stiffness": [np.nan, 1.0, 1.0],
    "rayleigh": [-1.0, 0.0],
    "ratios": [np.inf] * 3,
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_parameters_give_nan(name):
    """And one invalid particle leaves the gradients of the others alone."""
    arguments = random_chain(3, **{name: np.array(INVALID[name])})
    history, ones, d = np.ones((3, 150)), np.ones(3), arguments[:4]
    results = [
        *response_gradient(*arguments, history),
        *discrepancy_gradient(*arguments, history, ones),
        response_tangent(*arguments, *d),
        discrepancy_tangent(*arguments, history, *d),
    ]
    assert [x.shape for x in results] == [(3,), (3,), (2,), (3,)] * 2 + [(3, 150), (3,)]
    assert all(np.isnan(x).all() for x in results)
    rows = [np.stack([a, b]) for a, b in zip(arguments[:4], random_chain(3)[:4], strict=True)]
    for x in population_gradient(*rows, *arguments[4:], history, np.ones((2, 3))):
        assert np.isnan(x[0]).all()
        assert np.isfinite(x[1]).all()


def test_kernels_refuse_to_read_outside_their_arrays():
    arguments, d = random_chain(3), random_chain(3)[:4]
    for wrong in (np.zeros((3, 149)), np.zeros((2, 150))):
        with pytest.raises(ValueError, match="must have the shape"):
            response_gradient(*arguments, wrong)
        with pytest.raises(ValueError, match="must have the shape"):
            discrepancy_gradient(*arguments, wrong, np.ones(3))
        with pytest.raises(ValueError, match="must have the shape"):
            discrepancy_tangent(*arguments, wrong, *d)
    with pytest.raises(ValueError, match="must have the shapes of the parameters"):
        response_tangent(*arguments, *random_chain(4)[:4])
    unequal = arguments[0], np.ones(2), *arguments[2:]
    with pytest.raises(ValueError, match="must have equal lengths"):
        response_gradient(*unequal, np.zeros((3, 150)))
