"""Synthetic earthquakes: filtered white noise under an envelope.

White noise at bedrock passes through a soil layer that acts as an oscillator (Kanai-Tajimi) and
then through a high-pass filter that removes the unbounded drift (Clough-Penzien). The stationary
result is multiplied by an envelope that rises, holds and dies away (Amin-Ang), and scaled to the
wanted peak.
"""

import math
from dataclasses import dataclass

import numpy as np

from pymc_features._checks import LARGEST_COUNT, check_positive, check_seed, shown
from pymc_features.records import Record

__all__ = ["AminAng", "CloughPenzien", "synthetic_earthquake"]

MOST_SAMPLES = 10**8


@dataclass(frozen=True)
class CloughPenzien:
    r"""Power spectral density of the stationary ground acceleration, of bedrock noise S_0.

    .. math:: S(\omega) =
        \frac{\omega_g^4 + 4\zeta_g^2\omega_g^2\omega^2}
             {(\omega_g^2-\omega^2)^2 + 4\zeta_g^2\omega_g^2\omega^2} \;
        \frac{\omega^4}{(\omega_f^2-\omega^2)^2 + 4\zeta_f^2\omega_f^2\omega^2}\, S_0

    Parameters
    ----------
    omega_g, zeta_g : float
        Angular frequency [rad/s] and damping ratio of the ground, positive. The defaults, 5 pi rad/s
        (2.5 Hz) and 0.6, stand for firm soil.
    omega_f, zeta_f : float
        The same of the high-pass filter; `omega_f` is 0.1 `omega_g` unless given.
    """

    omega_g: float = 5.0 * math.pi
    zeta_g: float = 0.6
    omega_f: float | None = None
    zeta_f: float = 0.6

    def __post_init__(self):
        if self.omega_f is None:
            object.__setattr__(self, "omega_f", 0.1 * check_positive(self.omega_g, "omega_g"))
        for name in ("omega_g", "zeta_g", "omega_f", "zeta_f"):
            object.__setattr__(self, name, check_positive(getattr(self, name), name))

    @property
    def slowest_decay(self) -> float:
        """Decay rate of the slowest pole [1/s]."""
        return min(
            omega * (zeta - math.sqrt(max(zeta**2 - 1.0, 0.0)))
            for omega, zeta in ((self.omega_g, self.zeta_g), (self.omega_f, self.zeta_f))
        )


@dataclass(frozen=True)
class AminAng:
    """Envelope (t / t_1)^2 up to t_1, 1 up to t_2 = t_1 + `strong_time`, then exp(-k (t - t_2)).

    Parameters
    ----------
    rise_time, strong_time : float, optional
        Rise t_1 and plateau t_2 - t_1 [s], non-negative; 0.1 and 0.3 of the duration unless given.
    end_level : float
        Value at the last sample, above 0 and at most 1; sets the decay rate k.
    """

    rise_time: float | None = None
    strong_time: float | None = None
    end_level: float = 0.05

    def __post_init__(self):
        for name in ("rise_time", "strong_time"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, check_positive(value, name, allow_zero=True))
        object.__setattr__(self, "end_level", check_positive(self.end_level, "end_level"))
        if self.end_level > 1.0:
            raise ValueError(f"`end_level` must be at most 1, the plateau, got {self.end_level}.")

    def at(self, time: np.ndarray) -> np.ndarray:
        """Values at sampling times (time,) [s] from 0."""
        duration = time[-1]
        rise_time = 0.1 * duration if self.rise_time is None else self.rise_time
        strong_time = 0.3 * duration if self.strong_time is None else self.strong_time
        decay_start = rise_time + strong_time
        envelope = np.ones_like(time)
        rising, decaying = time < rise_time, time > decay_start
        envelope[rising] = (time[rising] / rise_time) ** 2
        if decaying.any():
            rate = -math.log(self.end_level) / (duration - decay_start)
            envelope[decaying] = np.exp(-rate * (time[decaying] - decay_start))
        return envelope


def synthetic_earthquake(
    duration: float = 30.0,
    dt: float = 0.02,
    random_seed: int | None = None,
    *,
    pga: float = 3.0,
    spectrum: CloughPenzien | None = None,
    envelope: AminAng | None = None,
) -> Record:
    """Draw an earthquake-like ground acceleration, a(t) = c e(t) x(t).

    x is stationary and Gaussian with a Clough-Penzien spectrum, e the envelope of Amin and Ang, and c makes
    the peak equal to `pga`.

    Parameters
    ----------
    duration : float
        Time of the last sample [s], positive, rounded to whole steps.
    dt : float
        Sampling interval [s], positive.
    random_seed : int, optional
        Non-negative; equal seeds and arguments give equal records.
    pga : float
        Peak ground acceleration [m/s^2], positive, reached exactly.
    spectrum : CloughPenzien, optional
        Of the stationary part, firm soil by default. Its frequencies are below Nyquist.
    envelope : AminAng, optional
        By default one that rises for a tenth of the duration and holds for three.

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
    The filter is applied in the frequency domain, so the spectrum of x is that asked for up to the Nyquist
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
    seed = check_seed(random_seed, several=False)
    duration, dt, pga = (
        check_positive(value, name) for name, value in dict(duration=duration, dt=dt, pga=pga).items()
    )
    spectrum = CloughPenzien() if spectrum is None else _of_type("spectrum", spectrum, CloughPenzien)
    envelope = AminAng() if envelope is None else _of_type("envelope", envelope, AminAng)
    for name, omega in dict(omega_g=spectrum.omega_g, omega_f=spectrum.omega_f).items():
        if omega >= math.pi / dt:
            raise ValueError(
                f"`{name}` must be below the Nyquist frequency {math.pi / dt:.4g} rad/s, got "
                f"{omega:.4g} rad/s. Take a smaller `dt`."
            )
    n_times = round(min(duration / dt, LARGEST_COUNT)) + 1
    if n_times < 2:
        raise ValueError(f"`duration` must be at least one step of {dt} s, got {duration} s.")
    memory = math.ceil(min(10.0 / (spectrum.slowest_decay * dt), LARGEST_COUNT))
    if n_times + memory > MOST_SAMPLES:
        raise ValueError(
            f"`dt` must leave at most {MOST_SAMPLES} samples of the duration and the memory of the filters, "
            f"got {dt:g} s. Take a larger `dt`, or a shorter `duration`."
        )
    stationary = _stationary(n_times, dt, spectrum, np.random.default_rng(seed), memory)
    acceleration = envelope.at(np.arange(n_times) * dt) * stationary
    acceleration = acceleration / np.abs(acceleration).max() * pga
    return Record(acceleration, dt, name="synthetic" if seed is None else f"synthetic {shown(seed)}")


def _of_type(name: str, value, kind: type):
    if not isinstance(value, kind):
        raise TypeError(f"`{name}` must be {kind.__name__}(...), got {type(value).__name__}.")
    return value


def _stationary(n_times, dt, spectrum: CloughPenzien, rng: np.random.Generator, memory: int) -> np.ndarray:
    """White noise (time,) through both filters, exact below the Nyquist frequency."""
    omega_g, zeta_g = spectrum.omega_g, spectrum.zeta_g
    omega_f, zeta_f = spectrum.omega_f, spectrum.zeta_f
    noise = np.fft.rfft(rng.standard_normal(n_times + memory))
    s = 2j * math.pi * np.fft.rfftfreq(n_times + memory, dt)  # the Laplace variable, i omega
    ground = ([2.0 * zeta_g * omega_g, omega_g**2], [1.0, 2.0 * zeta_g * omega_g, omega_g**2])
    high_pass = ([1.0, 0.0, 0.0], [1.0, 2.0 * zeta_f * omega_f, omega_f**2])
    for numerator, denominator in (ground, high_pass):
        noise = noise * np.polyval(numerator, s) / np.polyval(denominator, s)
    return np.fft.irfft(noise, n_times + memory)[memory:]
