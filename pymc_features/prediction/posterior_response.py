"""What an updated model predicts: responses, measured or not, of this earthquake or of another."""

from collections.abc import Callable, Sequence
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pymc.util import RandomGenerator

from pymc_features._checks import as_numbers, check_texts, message, shown
from pymc_features.prediction.draws import ResponseOptions, check_records, response_options, structure_draws
from pymc_features.records import CyclicTest, Loading, Record
from pymc_features.simulators import HISTORIES, times_of
from pymc_features.structures import Structure


def posterior_response(
    idata: xr.DataTree | xr.Dataset,
    structure: Callable[..., Structure],
    record: Record | Loading | CyclicTest,
    quantities: str | Sequence[str] = ("absolute_acceleration",),
    *,
    draws: int = 500,
    quantiles: ArrayLike = (0.05, 0.5, 0.95),
    random_seed: RandomGenerator = None,
    **kwargs: Unpack[ResponseOptions],
) -> xr.Dataset:
    """Bands of responses under the posterior, of measured or unmeasured quantities, to any earthquake.

    The posterior's draws are turned into structures, and the response of all of them is described by
    quantiles at each time. The bands hold the uncertainty of the parameters, and no other: no measurement
    noise and no error of the model. For bands that measured data should lie in, use
    `pm.sample_posterior_predictive` with the model of the inference.

    Parameters
    ----------
    idata : DataTree or Dataset
        With a group `posterior`; or a Dataset (chain, draw, ...).
    structure : callable
        Function of variables of the posterior, matched by the names of its parameters, that returns a
        structure, any that `simulate` takes, such as `lambda theta: paper.chain(theta)`. It is called with
        the numbers or arrays of one draw. Parameters that the posterior does not have keep their default.
    record : Record, Loading or CyclicTest
        Ground acceleration, of the inference or another; or, on linear structures, accelerations of several
        supports or forces; or, of specimens, the displacement.
    quantities : str or sequence of str
        Those of `simulate`, "inter_storey_drift" of chains and "base_shear" among them. Specimens have
        "restoring_force" only, which must be named.
    draws : int
        At most so many draws, equally many of each chain (but one at least), evenly spaced.
    quantiles : array_like
        Probabilities of the quantiles, from 0 to 1; sorted.
    random_seed : int or Generator, optional
        For the same draws each time.
    **kwargs
        `dt`, `sensors`, `n_modes` and `outputs` of `response`, the same for every draw. Drifts count their
        storeys in place of sensors.

    Returns
    -------
    Dataset
        For each quantity q with its unit in `attrs`: q (quantile, sensor, time), q_mean (sensor, time) and
        q_peak (sample, sensor), the largest absolute value over the output samples for each draw that was
        used, which `chain` and `draw` tell. Drifts have the dimension storey instead of sensor, the base
        shear has neither, or support where there are several. `attrs`: `draws_used`, `draws_left_out`,
        `record`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range, or no draw describes a structure.

    Warns
    -----
    PredictionWarning
        If draws describe no structure (a negative stiffness, say): they are left out, and counted.

    Notes
    -----
    Memory: besides the result, a block of times of all draws, 16 MiB at most; never (draw, sensor, time).
    Structures are simulated draw by draw; what their histories take beyond 16 MiB, 8 bytes for each draw, row
    and sample, is in a temporary file meanwhile. 500 draws of the ten-storey example, 1559 samples at ten
    sensors, take half a second (tests/prediction/test_prediction.py compares with those of all histories).

    The quantiles at each time are not those of a history: peaks have their own distribution, in q_peak.

    Examples
    --------
    A mass at rest for a moment moves against the ground by a dt^2 / 6 while a grows from zero:

    >>> from pymc_features import ModalDamping, Record, SpringMassChain
    >>> posterior = xr.Dataset({"k": (("chain", "draw"), [[1e-6, 1e-6]])})
    >>> record = Record([0.0, 0.6], dt=1.0, interpolation="linear")
    >>> found = posterior_response(
    ...     posterior, lambda k: SpringMassChain([2.0], k, ModalDamping(0.0)), record,
    ...     "relative_displacement")
    >>> found["relative_displacement"].sel(time=1.0).values.ravel().round(6)
    array([-0.1, -0.1, -0.1])
    """
    names, quantiles = checked_names(quantities), checked_quantiles(quantiles)
    options = response_options(kwargs, "posterior_response")
    check_records([record])
    drawn = structure_draws(
        idata, structure, [record], names, draws, random_seed, keep_histories=True, **options
    )
    with drawn as chosen:
        parts = {}
        for name in names:
            parts |= describe(chosen.ensemble, name, quantiles)
        times = times_of(record, chosen.ensemble.requests[0], len(chosen.ensemble.times(0)))
        return xr.Dataset(parts, chosen.labels | times, chosen.attrs | {"record": record.name})


def describe(ensemble, name, quantiles) -> dict:
    """Quantiles and mean at each time, and peaks, of one response."""
    times, rows = ensemble.times(0), ensemble.rows[name]
    shape = len(rows.labels), len(times)
    bands, mean = np.empty((len(quantiles), *shape)), np.empty(shape)
    for first, values in ensemble.blocks(name):
        block = slice(first, first + values.shape[1])
        mean[:, block] = values.mean(axis=-1)
        bands[:, :, block] = np.quantile(values, quantiles, axis=-1, overwrite_input=True)
    peak = ensemble.peaks(0, name)
    coords = {"quantile": quantiles, "time": ("time", times, {"units": "s"})} | row_coords(rows)
    row = tuple(row_coords(rows))
    if not row:
        bands, mean, peak = bands[:, 0], mean[0], peak[0]
    attrs = {"units": HISTORIES[name].units}
    arrays = {
        name: (("quantile", *row, "time"), bands),
        f"{name}_mean": ((*row, "time"), mean),
        f"{name}_peak": (("sample", *row), peak.T),
    }
    return {
        key: xr.DataArray(values, {d: coords[d] for d in dims if d in coords}, dims, attrs=attrs)
        for key, (dims, values) in arrays.items()
    }


def row_coords(rows) -> dict:
    """The coordinate of a response's rows; none for a response of one row."""
    return {rows.dim: (rows.dim, rows.labels, {"long_name": rows.title})} if rows.dim else {}


def checked_names(quantities) -> list[str]:
    """Names of responses, each once."""
    what = f"of {', '.join(HISTORIES)}"
    names = list(dict.fromkeys(check_texts(quantities, "quantities", what)))
    if not names or any(name not in HISTORIES for name in names):
        raise ValueError(message("quantities", what, shown(quantities)))
    return names


def checked_quantiles(quantiles) -> np.ndarray:
    """Probabilities, ascending."""
    given = as_numbers(quantiles, "quantiles", "Pass 0.05 for 5 %.")
    sorted_ = np.unique(given)
    if given.ndim > 1 or not sorted_.size or not ((sorted_ >= 0.0) & (sorted_ <= 1.0)).all():
        raise ValueError(f"`quantiles` must lie between 0 and 1, got {shown(quantiles)}. Pass 0.05 for 5 %.")
    return sorted_
