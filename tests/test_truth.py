"""The simulator of `benchmarks.truth`, against closed forms and other routes."""

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks import truth

RATE = 50.0
MASS, SPRINGS, RAYLEIGH = np.array([1.0, 2.0, 1.5]), np.array([900.0, 700.0, 500.0]), (0.4, 1e-3)
CHAIN = truth.chain_matrices(MASS, SPRINGS, RAYLEIGH)
DASHPOT = np.diag([0.0, 0.0, 3.0])  # couples the modes
SUPPORTS = np.array([[0.8, 0.2], [0.5, 0.5], [0.1, 0.9]])
PLACES = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, 2.0]])
STRUCTURES = {
    "classical": CHAIN,
    "coupled": CHAIN._replace(damping=CHAIN.damping + DASHPOT),
    "two supports": CHAIN._replace(influence=SUPPORTS),
    "forces": CHAIN._replace(damping=CHAIN.damping + DASHPOT, places=PLACES),
}


def error(found, expected):
    """Largest difference over the largest value."""
    return np.abs(found - expected).max() / np.abs(expected).max()


def history(structure, ends="moving", duration=10.0):
    """As many histories as act on a structure."""
    places = structure.influence if structure.places is None else structure.places
    return truth.motion(RATE, duration, 1, ends=ends, n_inputs=places.shape[1])


def oscillator(frequency, ratio):
    """Unit mass, natural frequency [Hz]."""
    w = np.full((1, 1), 2.0 * np.pi * frequency)
    return truth.Linear(np.eye(1), 2.0 * ratio * w, w**2, np.eye(1))


@pytest.mark.parametrize(("ends", "rate"), [("quiet", 50.0), ("moving", 200.0)])
def test_motion(ends, rate):
    """Band, peak, ends; samples are every fifth value of the finer grid."""
    m = truth.motion(rate, 12.0, 3, ends=ends, n_inputs=2)
    values, t = m.values(), m.time()
    assert values.shape == (2, 12 * rate + 1) and t[-1] == 12.0
    np.testing.assert_allclose(np.abs(values).max(axis=1), truth.PEAK)
    np.testing.assert_allclose(m.values(5)[:, ::5], values, atol=1e-13)
    f = m.angular_frequencies / (2.0 * np.pi)
    above = (f > 0.45 * rate + 2.0 * (ends == "quiet")) & (f < 0.5 * rate)
    assert np.abs(m.coefficients[:, above]).max() < 1e-5 * np.abs(m.coefficients).max()
    edge = np.abs(values[:, [0, 1, -2, -1]]).max()
    assert edge < 1e-12 if ends == "quiet" else edge > 0.1
    by_hand = (m.coefficients @ np.exp(1j * np.outer(m.angular_frequencies, t[100:103]))).real
    np.testing.assert_allclose(values[:, 100:103], by_hand, atol=1e-12)


@pytest.mark.parametrize("share", [0.03, 0.8, 1e6])
def test_harmonic_base_motion_from_rest(share):
    """Forced and free parts, Chopra, Dynamics of Structures, Eqs. (3.2.2)-(3.2.6), of a_g = cos(W t)."""
    w, zeta = 2.0 * np.pi * share * RATE, 0.02
    coefficients = np.zeros((1, 40))
    coefficients[0, 30] = 1.0
    m = truth.Motion(RATE, 500, coefficients, 700)
    t, big = m.time(), m.angular_frequencies[30]
    below, through = 1.0 - (big / w) ** 2, 2.0 * zeta * big / w
    c, d = -np.array([below, through]) / (w**2 * (below**2 + through**2))  # x = c cos + d sin + free
    damped = w * np.sqrt(1.0 - zeta**2)
    free_cos, free_sin = -c, -(d * big + zeta * w * c) / damped
    decay, phase = np.exp(-zeta * w * t), damped * t
    x = c * np.cos(big * t) + d * np.sin(big * t)
    x += decay * (free_cos * np.cos(phase) + free_sin * np.sin(phase))
    v = big * (d * np.cos(big * t) - c * np.sin(big * t))
    v += decay * (damped * free_sin - zeta * w * free_cos) * np.cos(phase)
    v -= decay * (damped * free_cos + zeta * w * free_sin) * np.sin(phase)
    found = truth.response(oscillator(share * RATE, zeta), m)
    assert error(found["relative_displacement"][0], x) < 1e-12
    assert error(found["relative_velocity"][0], v) < 1e-9
    assert error(found["absolute_acceleration"][0], -2.0 * zeta * w * v - w**2 * x) < 1e-12
    assert error(found["relative_acceleration"], found["absolute_acceleration"] - m.values()) < 1e-12


def hold(structure, moved, fine):
    """Displacements and velocities (2 n, time) for straight lines on a grid `fine` times finer, by expm."""
    m, c, k, influence, places = structure
    n, load = len(m), -influence if places is None else np.linalg.solve(m, places)
    d, u, h = load.shape[1], moved.values(fine), 1.0 / (moved.rate * fine)
    a = np.zeros((2 * n + 2 * d, 2 * n + 2 * d))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n] = -np.linalg.solve(m, np.hstack([k, c]))
    a[n : 2 * n, 2 * n : 2 * n + d], a[2 * n : 2 * n + d, 2 * n + d :] = load, np.eye(d) / h
    step = expm(a * h)[: 2 * n]
    state = np.zeros((u.shape[1], 2 * n))
    for j in range(u.shape[1] - 1):
        state[j + 1] = step @ np.concatenate([state[j], u[:, j], u[:, j + 1] - u[:, j]])
    return state.T[:, ::fine]


@pytest.mark.slow
@pytest.mark.parametrize("name", STRUCTURES)
def test_refined_straight_lines_converge_to_it(name):
    """Refined 64 times to 1e-5; extrapolated from 32 and 64, by the square of the step, to 1e-8."""
    structure = STRUCTURES[name]
    moved = history(structure)
    found = truth.response(structure, moved)
    expected = np.concatenate([found["relative_displacement"], found["relative_velocity"]])
    coarse, fine = (hold(structure, moved, k) for k in (32, 64))
    for part in (slice(0, 3), slice(3, 6)):
        assert error(fine[part], expected[part]) < 1e-5
        assert error(((4.0 * fine - coarse) / 3.0)[part], expected[part]) < 1e-8


def test_modes():
    """All of them are the structure; fewer are oscillators, superposed by hand."""
    moved = history(CHAIN)
    whole = truth.response(CHAIN, moved)
    for quantity, values in truth.response(CHAIN, moved, n_modes=3).items():
        assert error(values, whole[quantity]) < 1e-10
    w, shapes = truth.modes(CHAIN.mass, CHAIN.stiffness)
    x = 0.0
    for r in range(2):
        zeta = RAYLEIGH[0] / (2.0 * w[r]) + RAYLEIGH[1] * w[r] / 2.0
        one = truth.response(oscillator(w[r] / (2.0 * np.pi), zeta), moved)["relative_displacement"]
        x = x + shapes[:, [r]] * (shapes[:, r] @ MASS) * one
    found = truth.response(CHAIN, moved, n_modes=2)
    assert error(found["relative_displacement"], x) < 1e-10
    assert error(found["inter_storey_drift"][1], x[1] - x[0]) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(
    "springs", [truth.Springs(SPRINGS), truth.Springs(SPRINGS, 0.01)], ids=["k d", "a = 1"]
)
def test_solver_of_linear_springs(springs):
    """The ODE solver gives the Fourier solution where springs are linear."""
    moved = history(CHAIN)
    found = truth.spring_response(MASS, CHAIN.damping, springs, moved, fine=2)
    for quantity, values in truth.response(CHAIN, moved, fine=2).items():
        assert error(found[quantity], values) < 1e-7


@pytest.mark.slow
def test_bouc_wen_by_hand():
    """With p = 1 and beta = gamma, z = 1 - exp(-d / d_y) up to the first turn, then a line of slope 1."""
    k, d_y, a, c = 400.0, 0.002, 0.1, 0.3
    springs = truth.Springs(np.array([k]), d_y, a, 1.0)
    moved = history(oscillator(1.0, 0.0))
    found = truth.spring_response(np.ones(1), np.full((1, 1), c), springs, moved, fine=10)
    d, v, acceleration = (
        found[name][0] for name in ("relative_displacement", "relative_velocity", "absolute_acceleration")
    )
    z = (-acceleration - c * v - a * k * d) / ((1.0 - a) * k * d_y)
    turn, second = np.flatnonzero(np.diff(np.sign(v[1:])))[:2] + 1
    assert abs(d[turn]) > 0.2 * d_y
    np.testing.assert_allclose(
        z[:turn], np.sign(d[turn]) * (1.0 - np.exp(-np.abs(d[:turn]) / d_y)), atol=1e-6
    )
    back = slice(turn + 1, second)
    elastic = z[back] * np.sign(d[turn]) > 0.0
    turning = z[back][0] - d[back][0] / d_y
    np.testing.assert_allclose((z - d / d_y)[back][elastic], turning, atol=1e-6)
    assert elastic.sum() > 5
