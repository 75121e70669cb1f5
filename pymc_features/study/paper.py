"""The ten-storey example of the source: structure, measurements and sampling steps.

Its printed spring stiffness, 1000 N/m, contradicts its printed frequencies (1.0, 3.0, 4.9 Hz) and Rayleigh
coefficients (2 % in modes 1 and 5), which follow from 1800 N/m; that is the default here.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from pymc.util import RandomSeed
from pytensor.graph.basic import Variable

from pymc_features._checks import (
    LARGEST_COUNT,
    SAMPLING_INTERVAL,
    as_numbers,
    check_callable,
    check_positive,
    check_seed,
    message,
    shown,
)
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.structures import RayleighDamping, SpringMassChain, Structure
from pymc_features.structures.base import as_vector

N_STOREYS = 10
MASS = 1.0  # kg
STIFFNESS = 1800.0  # N/m; printed: 1000
DAMPING = RayleighDamping(alpha=0.2265, beta=6.7515e-4)  # Eq. (19): 2 % in modes 1 and 5
UNCERTAIN_SPRINGS = (0, 1, 2)  # theta scales the first three
MULTIPLIERS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # sampling steps over the record's step
NOISE = 0.05  # standard deviation over the root mean square of each channel
THETA_RANGE = (0.5, 1.5)  # prior of theta, uniform
SIGMA_RANGE = (0.0, 2.0)  # prior of sigma, uniform [m/s^2]
CORRELATION_TIME = 0.05  # of the errors, where it is taken for known [s]
# Errors that stay alike for longer than a tenth of the first period could pass for response.
TAU_RANGE = (1e-4, 0.1)  # prior of the correlation time elsewhere, uniform in its logarithm [s]


def chain(theta: float | Variable = 1.0, *, stiffness: float = STIFFNESS) -> SpringMassChain:
    """Ten masses of 1 kg on springs of which the first three are scaled by `theta`.

    Parameters
    ----------
    theta : float or TensorVariable
        Stiffness factor of springs 0 to 2 [-].
    stiffness : float
        Nominal spring stiffness [N/m].

    Examples
    --------
    >>> chain().modes().natural_frequencies[:3].round(2)
    array([1.01, 3.01, 4.93])
    """
    nominal = SpringMassChain(np.full(N_STOREYS, MASS), stiffness, DAMPING)
    theta = as_vector(theta, "theta", "Pass multiples of the nominal stiffness.")
    return nominal.scale_stiffness(theta, springs=UNCERTAIN_SPRINGS)


def measurements(
    record: Record,
    *,
    theta: float = 1.0,
    stiffness: float = STIFFNESS,
    noise: float = NOISE,
    noise_time: float = 0.0,
    random_seed: RandomSeed = None,
    multipliers: Sequence[float] = MULTIPLIERS,
    structure: Callable[..., Structure] = chain,
) -> xr.DataArray:
    """Floor accelerations at the finest sampling step, with noise added once.

    Parameters
    ----------
    record : Record
        Ground acceleration, taken as linear between its samples, as in the source.
    theta, stiffness : float
        The true structure.
    noise : float
        Standard deviation of the Gaussian noise over the root mean square of each channel [-].
    noise_time : float
        Time [s] after which the correlation of the noise has fallen to 1/e; 0 for the white noise of the
        source.
    random_seed : int, optional
        Of the noise; for the same each time.
    multipliers : sequence of float
        Sampling steps over the record's; the smallest is the finest step.
    structure : callable
        ``(theta, *, stiffness)`` -> structure of numbers.

    Returns
    -------
    xarray.DataArray (sensor, time)
        Absolute acceleration [m/s^2] at every floor. `decimate` takes coarser data from it.
    """
    if not isinstance(record, Record):
        raise TypeError(message("record", "a Record", shown(record), "Use read_record(path)."))
    check_callable(structure, "structure", "Pass for example paper.chain.")
    rng = np.random.default_rng(check_seed(random_seed, states=True))
    record, dt = with_straight_lines(record), min(checked_multipliers(multipliers)) * record.dt
    exact = simulate(structure(theta, stiffness=stiffness), record, dt=dt)
    scale = noise_scale(exact, noise)[:, None]
    return exact + scale * persistent(rng.standard_normal(exact.shape), dt, noise_time)


def with_straight_lines(record: Record) -> Record:
    """A record as the source takes it, linear between its samples."""
    return replace(record, interpolation="linear")


def checked_multipliers(multipliers: Sequence[float]) -> np.ndarray:
    """Sampling steps over the record's step, ascending, each once."""
    advice = "Pass sampling steps over the record's."
    steps = np.unique(as_numbers(multipliers, "multipliers", advice, what="a list of numbers"))
    if np.ndim(multipliers) != 1 or not steps.size or not (np.isfinite(steps) & (steps > 0.0)).all():
        raise ValueError(
            message("multipliers", "one or several positive numbers", shown(multipliers), advice)
        )
    return steps


def persistent(white: np.ndarray, dt: float, time: float) -> np.ndarray:
    """Noise of unit variance with the correlation exp(-lag / time), from white noise (sensor, time).

    Parameters
    ----------
    white : array (sensor, time)
        Independent standard normal samples.
    dt : float
        Their step [s].
    time : float
        Correlation time [s]; 0 leaves the noise white.
    """
    time = check_positive(time, "noise_time", "Pass 0 for white noise.", allow_zero=True)
    if time == 0.0:
        return white
    from scipy.signal import lfilter  # slow to import

    phi, rest = np.exp(-dt / time), np.sqrt(-np.expm1(-2.0 * dt / time))
    return lfilter([rest], [1.0, -phi], white, axis=1, zi=white[:, :1] * (1.0 - rest))[0]


def noise_scale(exact: xr.DataArray, noise: float = NOISE) -> np.ndarray:
    """Standard deviation of the noise of each channel (sensor,) [m/s^2].

    Parameters
    ----------
    exact : DataArray (sensor, time)
        Without noise.
    noise : float
        Over the root mean square of each channel [-].
    """
    return check_positive(noise, "noise", "Pass 0.05 for 5 %.", allow_zero=True) * np.sqrt(
        (exact.values**2).mean(axis=1)
    )


def decimate(finest: xr.DataArray, step: float) -> xr.DataArray:
    """Every n-th sample of the finest history, without filtering.

    Parameters
    ----------
    finest : DataArray (sensor, time)
        From `measurements`.
    step : float
        Wanted sampling step [s], an integer multiple of the finest.

    Examples
    --------
    >>> history = measurements(Record([0.0, 1.0, 0.0], dt=0.1))
    >>> history.sizes["time"], decimate(history, 0.1).sizes["time"]
    (21, 3)
    """
    if not isinstance(finest, xr.DataArray) or finest.dims != ("sensor", "time") or finest.sizes["time"] < 2:
        raise TypeError(message("finest", "a DataArray (sensor, time)", shown(finest), "Use `measurements`."))
    step, times = check_positive(step, "step", SAMPLING_INTERVAL), finest["time"].values
    ratio = min(step / (times[1] - times[0]), LARGEST_COUNT)
    if round(ratio) < 1 or abs(ratio / round(ratio) - 1.0) > 1e-6:
        raise ValueError(
            f"`step` must be an integer multiple of the finest step {times[1] - times[0]:g} s, "
            f"got {step:g} s."
        )
    return finest[:, :: round(ratio)]
