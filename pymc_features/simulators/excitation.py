"""What a record becomes before a march, and how finely it is refined: once, for all families.

A march joins samples by straight lines. Of a band-limited record it gets finer samples whose straight lines
have the record's spectrum (`band_limited`), under which the *states* of a structure are right: errors over
the peak, of content up to 0.45 of the sampling rate, are below 1e-4 for modes up to 0.3 of it, and 3e-4 for
one at 0.8 (`python -m benchmarks.band_limited`). What stands before the inputs in a response directly takes
the record's own samples, `Excitation.direct`.
"""

from math import gcd

import numpy as np

from pymc_features import band_limited
from pymc_features.exceptions import TooStiffError
from pymc_features.simulators.families import FAMILIES, NONLINEAR
from pymc_features.simulators.oscillators.arguments import NO_DIRECT, Excitation
from pymc_features.simulators.request import Request

FINE, MIDDLE, HIGHEST = 0.03, 0.15, 1.0  # of the sampling rate: frequencies from where factors change
FILLED = 128  # samples, a multiple of a block's
SHARE = 0.95  # of the structures whose highest frequency counts
STIFFEST = 500.0  # rate of a yielding chain, times the marched step, up to which steps through one are found


def excitation_of(values: np.ndarray, record, asked: Request) -> Excitation:
    """The excitation of a structure by the values (t,) or (d, t) of a load, at a request's outputs."""
    dt, substeps, stride = record.dt, asked.substeps, asked.stride
    if record.interpolation == "linear":
        return Excitation(np.require(values, requirements="W"), dt, substeps, stride, NO_DIRECT)
    rows = np.atleast_2d(values)
    fine = band_limited.refined(rows, asked.factor).reshape(*values.shape[:-1], -1)
    direct = own_values(rows, dt, substeps, stride)
    common = gcd(stride * asked.factor, substeps)
    return Excitation(fine, dt / asked.factor, substeps // common, stride * asked.factor // common, direct)


def own_values(rows: np.ndarray, dt: float, substeps: int, stride: int) -> np.ndarray:
    """`Excitation.direct` of a band-limited record (d, t), with zeros that fill the last block of a march."""
    found = band_limited.evaluated(rows, dt, substeps, stride)
    return np.pad(found, [(0, 0), (0, 0), (0, -found.shape[2] % FILLED)])


def refinement(frequencies: np.ndarray, dt: float) -> int:
    """How many times finer a band-limited record is marched.

    Parameters
    ----------
    frequencies : array (structure, m)
        Natural frequencies [Hz]; NaN where there are none.
    dt : float
        Sampling interval of the record [s].
    """
    shares = np.where(frequencies * dt <= HIGHEST, frequencies * dt, 0.0)  # those above follow the record
    is_there = np.isfinite(frequencies).any(axis=-1)
    if not is_there.any():
        return 4
    highest = np.quantile(shares[is_there].max(axis=-1), SHARE)
    return 1 if highest <= FINE else 2 if highest <= MIDDLE else 4


def frequencies_of(structure, parameters, constants, n_modes: int) -> np.ndarray:
    """Natural frequencies (structure, m) [Hz] of parameters with one more axis in front."""
    family = FAMILIES[structure.family]
    given = [np.array(x, dtype=np.float64, order="C") for x in parameters]
    given += [np.require(x, requirements="W") for x in constants]
    return family.modal["frequencies"](family.arguments(*given), n_modes)


def refined_request(structure, record, asked: Request) -> Request:
    """A request with the refinement that the modes of a structure of numbers need."""
    if structure.family == "linear" and record.interpolation != "linear":
        try:
            frequencies = structure.modes(asked.n_modes).natural_frequencies[None]
        except ValueError:  # no structure, whose response is NaN
            return asked
        return asked._replace(factor=refinement(frequencies, record.dt))
    if record.interpolation == "linear" and structure.family not in NONLINEAR:
        return asked
    parameters = [np.asarray(x)[None] for x in structure.parameters()]
    return request_of_family(structure, parameters, record, asked)


def request_of_family(structure, parameters, record, asked: Request) -> Request:
    """A request with the refinement that structures of parameters (structure, ...) need.

    Yielding chains that no step is small enough for are refused.
    """
    frequencies = frequencies_of(structure, parameters, structure.constants(record), asked.n_modes)
    if record.interpolation != "linear":
        asked = asked._replace(factor=refinement(frequencies, record.dt))
    if structure.family in NONLINEAR and np.isfinite(frequencies).any():
        given = dict(zip(FAMILIES[structure.family].parameters, parameters, strict=True))
        omega = 2.0 * np.pi * np.nanmax(frequencies, axis=-1)
        rates = np.fmax(omega, given["rayleigh"][..., 1] * omega**2)
        if np.nanmin(rates) * record.dt / asked.factor > STIFFEST:
            i = int(np.argmax(given["stiffness"][0]))
            raise TooStiffError(
                f"Spring {i} ({given['stiffness'][0, i]:.4g} N/m) is too stiff for a yielding chain, whose "
                f"fastest mode, of {omega.min() / (2.0 * np.pi):.4g} Hz, is followed step by step. Join the "
                "masses beside it into one, or make it at most 1,000 times stiffer than its neighbours."
            )
    return asked
