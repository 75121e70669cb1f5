"""Identified modes and those of a model as figures of both take them: checked, scaled, compared."""

from typing import NamedTuple

import numpy as np

from pymc_features._checks import as_array, as_numbers, message, shown
from pymc_features.modal import ModalData
from pymc_features.modal_features import mac


class Compared(NamedTuple):
    """Identified modes, i of them at s channels, and N draws of m modes of a model at p points.

    Attributes
    ----------
    measured : array (i, s)
        Real or complex shapes, NaN where an entry is missing.
    identified : array (i,)
        Frequencies [Hz].
    shapes : array (N, m, p)
        Of the model; N = 1 of one structure.
    frequencies : array (N, m) or None
        [Hz]
    partners : array (i,) or None
        Mode of the model that each is matched with.
    """

    measured: np.ndarray
    identified: np.ndarray
    shapes: np.ndarray
    frequencies: np.ndarray | None
    partners: np.ndarray | None


def compared(measured, shapes, frequencies, partners) -> Compared:
    """Check what both figures take."""
    if not isinstance(measured, ModalData):
        raise TypeError(
            message("measured", "a ModalData", shown(measured), "Read it with `read_modal`, or make one.")
        )
    if measured.shapes is None:
        raise ValueError(
            message("measured", "a ModalData with shapes", "frequencies alone", "Read the shapes as well.")
        )
    shapes = as_numbers(shapes, "shapes", "Pass those of the model.")
    if shapes.ndim < 2 or 0 in shapes.shape:
        raise ValueError(
            message("shapes", "of shape (..., mode, point)", shapes.shape, "Give one shape in each row.")
        )
    draws = shapes.reshape(-1, *shapes.shape[-2:])
    draws = draws[np.isfinite(draws).all(axis=(1, 2))]
    if not len(draws):
        raise ValueError(message("shapes", "finite in some draw", "NaN or infinity in all"))
    if frequencies is not None:
        frequencies = as_numbers(frequencies, "frequencies", "Pass those of the model in Hz.")
        possible = (frequencies > 0.0) & (frequencies < np.inf)
        good = (possible | np.isnan(frequencies)).all() and possible.any()
        if frequencies.shape != shapes.shape[:-1] or not good:
            raise ValueError(
                message("frequencies", f"{shapes.shape[:-1]} positive numbers in Hz", frequencies.shape)
            )
        frequencies = frequencies.reshape(-1, shapes.shape[-2])
    if partners is not None:
        partners = indices("partners", partners, len(measured), shapes.shape[-2], "mode of the model")
    return Compared(measured.shapes, measured.frequencies, draws, frequencies, partners)


def indices(name: str, values, n: int, most: int, what: str) -> np.ndarray:
    """An index from 0 to `most` - 1 for each of n."""
    array = as_array(values)
    is_whole = array.dtype.kind in "iu" and array.shape == (n,)
    if not is_whole or not ((array >= 0) & (array < most)).all():
        raise ValueError(
            message(
                name, f"{n} whole numbers from 0 to {most - 1}", shown(values), f"Give the {what} of each."
            )
        )
    return array


def macs(given: Compared, sensors=slice(None)) -> np.ndarray:
    """MAC (N, i, m) of each identified mode and each mode of the model, NaN without a shape."""
    draws, m, _ = given.shapes.shape
    found = mac(given.measured, given.shapes[:, :, sensors].reshape(draws * m, -1))
    return found.reshape(-1, draws, m).transpose(1, 0, 2)


def best_partners(agreement: np.ndarray) -> np.ndarray:
    """Modes (i,) of the model with the largest MAC (i, m) in total, each taken once."""
    from scipy.optimize import linear_sum_assignment

    i, m = agreement.shape
    if i > m:
        return np.nan_to_num(agreement).argmax(axis=1)
    return linear_sum_assignment(-np.nan_to_num(agreement))[1]


def quantiles(values: np.ndarray) -> np.ndarray:
    """5, 50 and 95 % (3, ...) over the first axis; NaN where all are."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of places that are NaN in all draws
        return np.nanquantile(values, [0.05, 0.5, 0.95], axis=0)
