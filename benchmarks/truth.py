"""Responses to band-limited motions, without anything of the package: what measured records are made from.

A motion is a Fourier sum, a(t) = Re sum_k c_k exp(i w_k t), known at every instant. A linear structure
follows each term by its transfer function, and from rest at t = 0 adds the free vibration that cancels
displacement and velocity of that sum at t = 0. Nothing marches and nothing joins samples, so a mode may be as
fast as one likes: closed forms of oscillators agree to 1e-12 of the peak (tests/test_truth.py). Springs that
yield or harden are integrated by an ODE solver under the same motion.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PPoly, make_interp_spline
from scipy.linalg import eigh
from scipy.special import erfc

LOWEST = 0.1  # Hz
PEAK = 3.0  # of the samples [m/s^2]
PERIOD = 1.37  # over the duration
RAMP, CENTRE = 0.6, 3.6  # s: of an end, 0.5 erfc((CENTRE - t) / RAMP), which is 1e-17 at t = 0
SPLINE = 32  # points of a spline to one sample


class Motion(NamedTuple):
    """Histories that act together, n_times samples each, at t = 0, 1 / rate, ...

    Attributes
    ----------
    rate : float
        Samples per second [Hz].
    n_times : int
        Number of samples.
    coefficients : complex array (input, k)
        c_k at the angular frequencies 2 pi k / period, k = 1, 2, ...; m/s^2, or N.
    n_period : int
        Samples in a period of the sum, more than `n_times`.
    """

    rate: float
    n_times: int
    coefficients: np.ndarray
    n_period: int

    @property
    def angular_frequencies(self):
        """2 pi k / period (k,) [rad/s]."""
        return 2.0 * np.pi * self.rate / self.n_period * np.arange(1, self.coefficients.shape[1] + 1)

    def series(self, coefficients, fine=1):
        """Re sum_k c_k exp(i w_k t) (..., time) of coefficients (..., k), `fine` to a sample."""
        n = self.n_period * fine
        spectrum = np.zeros((*coefficients.shape[:-1], n // 2 + 1), complex)
        spectrum[..., 1 : coefficients.shape[-1] + 1] = 0.5 * n * coefficients
        return np.fft.irfft(spectrum, n)[..., : (self.n_times - 1) * fine + 1]

    def values(self, fine=1):
        """The histories (input, time), `fine` times as often as sampled."""
        return self.series(self.coefficients, fine)

    def time(self, fine=1):
        """Instants (time,) [s]."""
        return np.arange((self.n_times - 1) * fine + 1) / (self.rate * fine)


def motion(rate, duration, seed, *, top=0.45, ends="quiet", rolloff=8.0, n_inputs=1) -> Motion:
    """Random motions with content from 0.1 Hz to `top` of the rate, and a peak of 3 m/s^2 among the samples.

    Parameters
    ----------
    rate, duration : float
        Samples per second [Hz], and time of the last sample [s].
    seed : int
    top : float
        Highest frequency over the rate [-], below 0.5.
    ends : str
        "quiet": at rest at both ends, by smooth ramps of seven seconds, which widen the band by 2 Hz;
        "moving": cut out of a stationary motion.
    rolloff : float
        Amplitudes fall as 1 / sqrt(1 + (f / rolloff)^2) [Hz].
    n_inputs : int
        Number of independent histories.
    """
    rng, n = np.random.default_rng(seed), round(duration * rate) + 1
    n_period = int(PERIOD * n) | 1
    f = rate / n_period * np.arange(1, n_period // 2 + 1)
    c = rng.standard_normal((n_inputs, f.size)) + 1j * rng.standard_normal((n_inputs, f.size))
    c *= ((f > LOWEST) & (f < top * rate)) / np.sqrt(1.0 + (f / rolloff) ** 2)
    result = Motion(rate, n, c, n_period)
    if ends == "quiet":
        whole, t = result._replace(n_times=n_period), np.arange(n_period) / rate
        envelope = 0.25 * erfc((CENTRE - t) / RAMP) * erfc((t - t[n - 1] + CENTRE) / RAMP)
        values = whole.values()
        values -= (values @ envelope / envelope.sum())[:, None]  # so that the product has no mean
        c = 2.0 / n_period * np.fft.rfft(values * envelope)[:, 1:]
    scale = PEAK / np.abs(result._replace(coefficients=c).values()).max(axis=1, keepdims=True)
    return result._replace(coefficients=c * scale)


class Linear(NamedTuple):
    """M x" + C x' + K x = -M influence a_g(t), or + places f(t) where there are `places`. K is not singular.

    Attributes
    ----------
    mass, damping, stiffness : array (n, n)
        Symmetric M [kg], any C [N s/m], K [N/m].
    influence : array (n, d)
        Displacement under unit displacements of the supports [-].
    places : array (n, d), optional
        Loads on the degrees of freedom under unit forces [-].
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    influence: np.ndarray
    places: np.ndarray | None = None


def modes(mass, stiffness, n_modes=None):
    """Angular frequencies (m,) [rad/s] and shapes (n, m) of unit modal mass, lowest first."""
    squares, shapes = eigh(stiffness, mass)
    return np.sqrt(squares[:n_modes]), shapes[:, :n_modes]


def response(structure: Linear, moved: Motion, n_modes=None, fine=1):
    """All quantities, by their names in the package, (n, time) or (d, time), of the structure from rest.

    With `n_modes` of the lowest modes alone; the absolute acceleration keeps what the base gives the others.
    """
    mass, damping, stiffness, influence, places = structure
    load = -mass @ influence if places is None else places
    shapes = np.eye(len(mass)) if n_modes is None else modes(mass, stiffness, n_modes)[1]
    small = [shapes.T @ a @ shapes for a in (mass, damping, stiffness)]
    displacement, velocity, acceleration = (
        shapes @ x for x in follow(small, shapes.T @ load @ moved.coefficients, moved, fine)
    )
    absolute = acceleration if places is not None else acceleration + influence @ moved.values(fine)
    shear = influence.T @ mass @ absolute
    return {
        "relative_displacement": displacement,
        "relative_velocity": velocity,
        "relative_acceleration": acceleration,
        "absolute_acceleration": absolute,
        "inter_storey_drift": drift(displacement),
        "base_shear": shear if places is None else shear - influence.T @ places @ moved.values(fine),
    }


def drift(displacement):
    """x_i - x_{i-1} (n, time), the first against the base."""
    return np.diff(displacement, axis=0, prepend=0.0)


def follow(matrices, load, moved, fine):
    """Displacement, velocity, acceleration (3, n, time) from rest, under the load of coefficients (n, k)."""
    mass, damping, stiffness = matrices
    n, s = len(mass), 1j * moved.angular_frequencies
    impedance = s[:, None, None] ** 2 * mass + s[:, None, None] * damping + stiffness
    x = np.linalg.solve(impedance, load.T[..., None])[..., 0].T  # (n, k)
    forced = moved.series(np.stack([x, s * x, s**2 * x]), fine)
    state = np.zeros((2 * n, 2 * n))
    state[:n, n:] = np.eye(n)
    state[n:] = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    poles, vectors = np.linalg.eig(state)
    start = np.concatenate([x.real.sum(axis=1), (s * x).real.sum(axis=1)])
    weights = vectors[:n] * np.linalg.solve(vectors, -start)
    free = np.exp(np.multiply.outer(poles, moved.time(fine)))
    return forced + np.stack([(weights * poles**i @ free).real for i in range(3)])


class Springs(NamedTuple):
    """Spring i joins masses i - 1 and i, the first the base; d is its drift. Arrays (n,), or one number.

    Bouc-Wen: f = a k d + (1 - a) k d_y z and d_y z' = d' [1 - |z|^p (gamma + beta sign(d' z))]. Cubic, where
    there is no `yield_displacement`: f = k d + c d^3.
    """

    stiffness: np.ndarray  # k [N/m]
    yield_displacement: np.ndarray | None = None  # d_y [m]
    post_yield_ratio: np.ndarray = 1.0  # a [-]
    sharpness: np.ndarray = 2.0  # p [-]
    beta: np.ndarray = 0.5
    gamma: np.ndarray = 0.5
    cubic: np.ndarray = 0.0  # c [N/m^3]


def chain_matrices(mass, stiffness, rayleigh=(0.0, 0.0)) -> Linear:
    """A chain of masses (n,) [kg] on springs (n,) [N/m], with C = alpha M + beta K."""
    m, to_drift = np.diag(mass), np.eye(len(mass)) - np.eye(len(mass), k=-1)
    k = to_drift.T @ np.diag(stiffness) @ to_drift
    return Linear(m, rayleigh[0] * m + rayleigh[1] * k, k, np.ones((len(mass), 1)))


def spring_response(mass, damping, springs: Springs, moved: Motion, *, fine=1, rtol=1e-9):
    """The quantities of `response` of a chain of masses (n,) with damping C (n, n), from rest.

    By DOP853; `rtol` is relative to the state, absolute values are those of drifts of 1 mm. Errors of chains
    that yield are 1e-5 of the peak with 1e-7, 1e-6 with 1e-9, by comparison with 1e-10.
    """
    k, d_y, a, p, beta, gamma, cubic = springs
    n, base = len(mass), interpolated(moved)

    def rates(t, state):
        x, v, z = state.reshape(3, n)
        d, v_d = x.copy(), v.copy()
        d[1:] -= x[:-1]
        v_d[1:] -= v[:-1]
        if d_y is None:
            force, z_rate = k * d + cubic * d**3, 0.0 * z
        else:
            force = a * k * d + (1.0 - a) * k * d_y * z
            z_rate = v_d / d_y * (1.0 - np.abs(z) ** p * (gamma + beta * np.sign(v_d * z)))
        net = -force - damping @ v
        net[:-1] += force[1:]
        return np.concatenate([v, net / mass - base(t), z_rate])

    t = moved.time(fine)
    options = {"rtol": rtol, "atol": np.repeat([1e-3, 1e-2, 1.0], n) * rtol, "max_step": 1.0 / moved.rate}
    found = solve_ivp(rates, (0.0, t[-1]), np.zeros(3 * n), "DOP853", t_eval=t, **options).y
    acceleration = np.stack([rates(*x)[n : 2 * n] for x in zip(t, found.T, strict=True)], axis=1)
    absolute = acceleration + moved.values(fine)
    return {
        "relative_displacement": found[:n],
        "relative_velocity": found[n : 2 * n],
        "relative_acceleration": acceleration,
        "absolute_acceleration": absolute,
        "inter_storey_drift": drift(found[:n]),
        "base_shear": (mass @ absolute)[None],
    }


def interpolated(moved: Motion):
    """The only history as a function of time [s]: a quintic spline through 32 points to a sample."""
    t = moved.time(SPLINE)
    pieces = PPoly.from_spline(make_interp_spline(t, moved.values(SPLINE)[0], k=5))
    starts, c = pieces.x, pieces.c.T.tolist()

    def at(time):
        place = min(max(np.searchsorted(starts, time, "right") - 1, 5), len(c) - 6)
        u, value = time - starts[place], 0.0
        for x in c[place]:
            value = value * u + x
        return value

    return at


def specimen_force(law, displacement, rtol=1e-12):
    """Force (time,) [N] of a specimen of Bouc, Wen, Baber and Noori under a displacement (time,) [m].

    `law` are k, d_y, a, n, beta, gamma, delta_nu, delta_eta, zeta_s, p, q, psi, delta_psi, lambda. One branch
    after the other is integrated, each on one side of z = 0.
    """
    k, reach, ratio, n, beta, gamma, d_nu, d_eta, slip, p, q, psi, d_psi, severity = law
    solver = {"rtol": rtol, "atol": 0.1 * rtol, "method": "DOP853", "max_step": 0.1}
    z, e, before, found = 0.0, 0.0, 0.0, []

    def slope_of(side, way):
        def slope(_, state):
            z, e = state
            nu, eta = 1.0 + d_nu * e, 1.0 + d_eta * e
            z_u = (1.0 / (nu * (beta + gamma))) ** (1.0 / n)
            zeta_1 = slip * (1.0 - np.exp(-p * e))
            zeta_2 = (psi + d_psi * e) * (severity + zeta_1)
            h = 1.0 - zeta_1 * np.exp(-((z * way - q * z_u) ** 2) / zeta_2**2)
            return way * h * (1.0 - nu * abs(z) ** n * (gamma + beta * side)) / eta, way * z

        return slope

    def passes_zero(_, state):
        return state[0]

    passes_zero.terminal = True
    for d in displacement:
        way, start, end = np.sign(d - before), 0.0, abs(d - before) / reach
        if way and z * way < 0.0:
            part = solve_ivp(slope_of(-1.0, way), (start, end), (z, e), events=passes_zero, **solver)
            (z, e), start = part.y[:, -1], part.t[-1]
            z = 0.0 if part.status == 1 else z
        if way and start < end and z * way >= 0.0:
            z, e = solve_ivp(slope_of(1.0, way), (start, end), (z, e), **solver).y[:, -1]
        before = d
        found.append(ratio * k * d + (1.0 - ratio) * k * reach * z)
    return np.array(found)


def cycles(reach, peaks, steps):
    """Displacement through peaks, multiples of the yield displacement, in so many steps each."""
    ways = np.arange(len(peaks) * steps + 1) / steps
    return reach * np.interp(ways, np.arange(len(peaks) + 1), [0.0, *peaks])
