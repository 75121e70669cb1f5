"""Synthetic earthquakes: filtered white noise under an envelope.

White noise at bedrock passes through a soil layer that acts as an oscillator (Kanai-Tajimi) and
then through a high-pass filter that removes the unbounded drift (Clough-Penzien). The stationary
result is multiplied by an envelope that rises, holds and dies away (Amin-Ang), and scaled to the
wanted peak.
"""

import math

import numpy as np

from pymc_features._checks import check_integer, check_positive
from pymc_features.records import Record

__all__ = ["synthetic_earthquake"]


def synthetic_earthquake(
    duration: float = 30.0,
    dt: float = 0.02,
    seed: int = 1940,
    *,
    pga: float = 3.0,
    omega_g: float = 5.0 * math.pi,
    zeta_g: float = 0.6,
    omega_f: float | None = None,
    zeta_f: float = 0.6,
    rise_time: float | None = None,
    strong_time: float | None = None,
    end_level: float = 0.05,
) -> Record:
    r"""Draw an earthquake-like ground acceleration with a Clough-Penzien spectrum.

    .. math:: a(t) = c\, e(t)\, x(t), \qquad S_x(\omega) =
        \frac{\omega_g^4 + 4\zeta_g^2\omega_g^2\omega^2}
             {(\omega_g^2-\omega^2)^2 + 4\zeta_g^2\omega_g^2\omega^2} \;
        \frac{\omega^4}{(\omega_f^2-\omega^2)^2 + 4\zeta_f^2\omega_f^2\omega^2}\, S_0,

    where x is stationary and Gaussian, the envelope e is (t/t_1)^2 up to t_1, 1 up to t_2 = t_1 +
    `strong_time`, then exp(-k (t - t_2)), and c makes the peak equal to `pga`.

    Parameters
    ----------
    duration : float
        Time of the last sample [s], positive, rounded to whole steps.
    dt : float
        Sampling interval [s], positive.
    seed : int
        Non-negative; equal seeds and arguments give equal records.
    pga : float
        Peak ground acceleration [m/s^2], positive, reached exactly.
    omega_g, zeta_g : float
        Angular frequency [rad/s], below Nyquist, and damping ratio of the ground, positive. The
        defaults, 5 pi rad/s (2.5 Hz) and 0.6, stand for firm soil.
    omega_f, zeta_f : float
        The same of the high-pass filter; `omega_f` is 0.1 `omega_g` unless given.
    rise_time, strong_time : float, optional
        Rise t_1 and plateau t_2 - t_1 of the envelope [s], non-negative; 0.1 and 0.3 of `duration`
        unless given.
    end_level : float
        Value of the envelope at the last sample, above 0 and at most 1; sets the decay rate k.

    Returns
    -------
    Record
        Acceleration (time,) [m/s^2], round(duration / dt) + 1 samples.

    Raises
    ------
    ValueError, TypeError
        If an argument is not admissible.

    Notes
    -----
    The filter is applied in the frequency domain, so the spectrum of x is S_x up to the Nyquist
    frequency for every `dt`, without aliasing or frequency warping, and zero above; the transform
    is long enough for its wrapped-around end to have died out. Records of one seed at two `dt` are
    different draws. The velocity at the end is not exactly zero. `test_ground_motion.py` compares
    the spectrum with the closed form.

    References
    ----------
    Clough, R. W. and Penzien, J., Dynamics of Structures, section on stochastic ground motion.
    Kanai, K. (1957), Bull. Earthq. Res. Inst. 35, 309-325. Tajimi, H. (1960), Proc. 2nd WCEE,
    781-797. Amin, M. and Ang, A. H.-S. (1968), J. Eng. Mech. Div. ASCE 94, 559-583.

    Examples
    --------
    >>> record = synthetic_earthquake(20.0, 0.01, 7, pga=2.5)
    >>> record
    Record('synthetic 7', 2001 samples, dt=0.01 s, duration=20 s, pga=2.5 m/s^2)
    """
    seed = check_integer(seed, "seed", least=0)
    positive = dict(duration=duration, dt=dt, pga=pga, omega_g=omega_g, zeta_g=zeta_g, zeta_f=zeta_f)
    for name, value in positive.items():
        check_positive(value, name)
    omega_f = 0.1 * omega_g if omega_f is None else omega_f
    check_positive(omega_f, "omega_f")
    for name, omega in dict(omega_g=omega_g, omega_f=omega_f).items():
        if omega >= math.pi / dt:
            raise ValueError(
                f"`{name}` must be below the Nyquist frequency {math.pi / dt:.4g} rad/s, got "
                f"{omega:.4g} rad/s. Take a smaller `dt`."
            )
    n_times = round(duration / dt) + 1
    if n_times < 2:
        raise ValueError(f"`duration` must be at least one step of {dt} s, got {duration} s.")
    time = np.arange(n_times) * dt
    envelope = _envelope(time, rise_time, strong_time, end_level)
    filters = (omega_g, zeta_g, omega_f, zeta_f)
    acceleration = envelope * _stationary(n_times, dt, filters, np.random.default_rng(seed))
    acceleration = acceleration / np.abs(acceleration).max() * pga
    return Record(acceleration, dt, name=f"synthetic {seed}")


def _envelope(time: np.ndarray, rise_time, strong_time, end_level) -> np.ndarray:
    """Amin-Ang envelope (time,)."""
    duration = time[-1]
    rise_time = 0.1 * duration if rise_time is None else rise_time
    strong_time = 0.3 * duration if strong_time is None else strong_time
    for name, value in dict(rise_time=rise_time, strong_time=strong_time).items():
        check_positive(value, name, allow_zero=True)
    check_positive(end_level, "end_level")
    if end_level > 1.0:
        raise ValueError(f"`end_level` must be at most 1, the plateau, got {end_level}.")
    decay_start = rise_time + strong_time
    envelope = np.ones_like(time)
    rising, decaying = time < rise_time, time > decay_start
    envelope[rising] = (time[rising] / rise_time) ** 2
    if decaying.any():
        rate = -math.log(end_level) / (duration - decay_start)
        envelope[decaying] = np.exp(-rate * (time[decaying] - decay_start))
    return envelope


def _stationary(n_times: int, dt: float, filters, rng: np.random.Generator) -> np.ndarray:
    """White noise (time,) through both filters, exact below the Nyquist frequency."""
    omega_g, zeta_g, omega_f, zeta_f = filters
    slowest = min(  # decay rate [1/s] of the slowest pole
        omega * (zeta - math.sqrt(max(zeta**2 - 1.0, 0.0)))
        for omega, zeta in ((omega_g, zeta_g), (omega_f, zeta_f))
    )
    memory = math.ceil(10.0 / (slowest * dt))
    noise = np.fft.rfft(rng.standard_normal(n_times + memory))
    s = 2j * math.pi * np.fft.rfftfreq(n_times + memory, dt)  # the Laplace variable, i omega
    ground = ([2.0 * zeta_g * omega_g, omega_g**2], [1.0, 2.0 * zeta_g * omega_g, omega_g**2])
    high_pass = ([1.0, 0.0, 0.0], [1.0, 2.0 * zeta_f * omega_f, omega_f**2])
    for numerator, denominator in (ground, high_pass):
        noise = noise * np.polyval(numerator, s) / np.polyval(denominator, s)
    return np.fft.irfft(noise, n_times + memory)[memory:]
