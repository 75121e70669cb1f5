"""The probability that a response exceeds a limit, under the posterior."""

from collections.abc import Callable, Sequence
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pymc.util import RandomGenerator

from pymc_features._checks import as_numbers, check_choice, shown
from pymc_features.prediction.draws import ResponseOptions, check_records, response_options, structure_draws
from pymc_features.prediction.posterior_response import row_coords
from pymc_features.records import Loading, Record
from pymc_features.simulators import HISTORIES
from pymc_features.structures import Structure


def first_passage_probability(
    idata: xr.DataTree | xr.Dataset,
    structure: Callable[..., Structure],
    record: Record | Loading | Sequence[Record | Loading],
    limit: ArrayLike,
    quantity: str = "inter_storey_drift",
    *,
    draws: int = 500,
    random_seed: RandomGenerator = None,
    **kwargs: Unpack[ResponseOptions],
) -> xr.Dataset:
    """Probability under the posterior that the largest absolute response exceeds a limit.

    ``P(limit) = E[ 1{max_t |r(t)| > limit} ]`` over the posterior, for each storey and for any of them; over
    many limits it is a fragility curve, over many earthquakes, all as likely as each other, their total
    probability. The uncertainty is that of the parameters; see `prediction.posterior_response`.

    Parameters
    ----------
    idata, structure, draws, random_seed
        As in `prediction.posterior_response`.
    record : Record or Loading, or a sequence of them
        Ground accelerations, or other loads as in `prediction.posterior_response`.
    limit : float or array_like (limit,)
        Positive, in the unit of the quantity.
    quantity : str
        As in `prediction.posterior_response`.
    **kwargs
        `dt`, `sensors`, `n_modes` and `outputs` of `response`, the same for every draw and record. "Any" is
        any of `sensors` or `outputs`.

    Returns
    -------
    Dataset
        `probability` (limit, storey) and `probability_any` (limit), of all records together, each with its
        standard error in `..._se`; `record_probability` (record, limit, storey) and `record_probability_any`
        (record, limit); `peak` (record, sample, storey), from which any other limit can be judged, with the
        `chain` and `draw` of each sample. The dimension is sensor instead of storey for quantities other than
        the drift, and the base shear has none, or support where there are several. A number as limit gives
        no dimension limit. `attrs` as in `prediction.posterior_response`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range, or no draw describes a structure.

    Warns
    -----
    PredictionWarning
        If draws describe no structure: they are left out, and counted.

    Notes
    -----
    Standard errors are those of the finite number of draws, for these records: sqrt(v / n) with v the
    variance over draws of the share of records that exceed, and n the effective number of draws by their
    autocorrelation (ArviZ), at most their number. Half a draw above and half a draw below the limit are added
    to v, so that no exceedance among n draws is not taken for certain. Draws repeated by a sampler's
    resampling count as different ones.

    Peaks are those of the output samples: pass a smaller `dt` where the highest mode is short of samples.
    500 draws of the ten-storey example cost a fifth of a second for each record; one history is held at a
    time.

    Examples
    --------
    The base shear of a stiff structure is mass times ground acceleration; two of four masses exceed 1 kg:

    >>> from pymc_features import ModalDamping, Record, SpringMassChain
    >>> posterior = xr.Dataset({"m": (("chain", "draw"), [[0.8, 0.9, 1.1, 1.2]])})
    >>> record = Record([0.0, 1.0], dt=1.0, interpolation="linear")
    >>> found = first_passage_probability(
    ...     posterior, lambda m: SpringMassChain([m], 1e6, ModalDamping(0.1)), record, limit=1.0,
    ...     quantity="base_shear")
    >>> float(found["probability"])
    0.5
    """
    check_choice(quantity, "quantity", HISTORIES)
    limits = checked_limits(limit)
    records = checked_records(record)
    options = response_options(kwargs, "first_passage_probability")
    with structure_draws(idata, structure, records, [quantity], draws, random_seed, **options) as chosen:
        row, units = row_coords(chosen.ensemble.rows[quantity]), {"units": HISTORIES[quantity].units}
        peak = np.stack([chosen.ensemble.peaks(k, quantity).T for k in range(len(records))])
        peak = xr.DataArray(peak if row else peak[..., 0], dims=("record", "sample", *row), attrs=units)
        names = {"record": np.arange(len(records)), "record_name": ("record", [r.name for r in records])}
        limits = xr.DataArray(limits, dims=("limit",)[: limits.ndim], attrs=units)
        parts = {"peak": peak} | exceedance(peak, limits, tuple(row), chosen.used)
        coords = row | chosen.labels | names | {"limit": limits}
        return xr.Dataset(parts, coords, chosen.attrs | {"quantity": quantity})


def exceedance(peak, limits, row: tuple[str, ...], used) -> dict[str, xr.DataArray]:
    """Probabilities of peaks (record, sample, *row) above the limits, and their standard errors."""
    parts, above = {}, peak > limits
    above = above.transpose("record", *limits.dims, *row, "sample")
    for name, exceeded in (("probability", above), ("probability_any", above.any(row) if row else above)):
        shares = exceeded.mean("record")  # of the records, by draw
        parts[name] = shares.mean("sample")
        error = standard_error(shares.values.reshape(-1, shares.sizes["sample"]), used)
        parts[f"{name}_se"] = parts[name].copy(data=error.reshape(parts[name].shape))
        parts[f"record_{name}"] = exceeded.mean("sample")
    return {name: part.assign_attrs(units="1") for name, part in parts.items()}


def standard_error(shares, used) -> np.ndarray:
    """Standard error of the mean of shares (row, sample) in [0, 1], whose samples stand where `used`."""
    n = shares.shape[-1]
    mean = (shares.sum(axis=-1) + 0.5) / (n + 1)
    square = ((shares**2).sum(axis=-1) + 0.5) / (n + 1)
    return np.sqrt((square - mean**2) / effective_draws(shares, used))


def effective_draws(shares, used) -> np.ndarray:
    """Effective number of draws for the mean of each row, 1 to n; constant rows count in full."""
    import arviz as az  # slow to import

    n = shares.shape[-1]
    result = np.full(len(shares), float(n))
    if used.shape[1] < 4:
        return result
    for row in np.flatnonzero(np.ptp(shares, axis=-1) > 0.0):
        placed = np.full(used.shape, shares[row].mean())  # draws that were left out say nothing
        placed[used] = shares[row]
        result[row] = float(az.ess(placed, method="mean")) * n / used.size
    return np.clip(np.nan_to_num(result, nan=n), 1.0, n)


def checked_records(record) -> list:
    """One record or several, as a list."""
    records = (
        list(record) if isinstance(record, Sequence) and not isinstance(record, str | bytes) else [record]
    )
    if not records:
        raise ValueError("`record` must be one Record or several, got none.")
    check_records(records)
    return records


def checked_limits(limit) -> np.ndarray:
    """A positive number, or a vector of them."""
    limits = as_numbers(limit, "limit", "Pass it in the unit of the quantity.")
    if limits.ndim > 1 or not limits.size or not (np.isfinite(limits) & (limits > 0.0)).all():
        raise ValueError(
            f"`limit` must be a positive number or a vector of them, got {shown(limit)}. Pass it in the unit "
            "of the quantity, such as 0.01 m of drift."
        )
    return limits
