"""Frequency response functions of measured excitation and response, with the variance of every line.

Y = H X + noise at each line of averages, which are blows or segments, with weights c:

    S_xx = sum c X X^H,   S_yx = sum c Y X^H,   H1 = S_yx S_xx^-1,   H2 = H1 / gamma^2,   Hv = H1 / gamma
    E|H1 - H|^2 = N (S_xx^-1)_aa,   N = sum c |Y - H1 X|^2 / (number of averages - references)

A few averages do not tell N, neighbouring lines do so together. Blows noisier than others count less: 1/c is
the mean over lines of |Y - H1 X|^2 / (N (1 - c X^H S_xx^-1 X)), of which the bracket is the fit to the blow.
"""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features import _checks as checks
from pymc_features._checks import message, require
from pymc_features.signals.channels import check_array, check_band, step_of, warn_channel
from pymc_features.signals.check import flat_tops
from pymc_features.signals.spectra import windowed_spectra

EXCITATIONS = {"N": "force", "m/s^2": "base"}  # by units, as the next; the first of bare arrays
QUANTITIES = {"m/s^2": "accelerance", "m/s": "mobility", "m": "receptance"}
#: Units of a function: those of excitation and response.
RATIOS = [(x, y) for x in ("N", "(m/s^2)") for y in ("(m/s^2)", "(m/s)", "m")]
RATIOS = {f"{y}/{x}": (x.strip("()"), y.strip("()")) for x, y in RATIOS}
DIMS = "reference", "blow", "response", "time"
HIT, SHORT = 0.1, 0.1  # of the peak of a force, above what filters ring; of a record, at most, is a blow
LINES = 100  # averages times lines for a variance, which has an error of 10 %
STEPS, LEAST = 10, 1e-3  # in which weights of blows settle; level of a blow, at least, of the mean
MANY = 5  # blows, of which each can be weighed: with three, variances would be a third too small
RANK, ROUNDING = 1e-6, 1e-24  # least eigenvalue of S_xx of unit powers; power that is none, of the largest
HANN = 35.0 / 18.0, 1.0 / 36.0  # mean(w^4) / mean(w^2)^2; squared correlation of windows half over each other


def frequency_response(
    excitation: ArrayLike | xr.DataArray | str | list[str],
    response: ArrayLike | xr.DataArray,
    *,
    dt: float | None = None,
    fs: float | None = None,
    method: str = "H1",
    units: str | None = None,
    band: tuple[float, float] | None = None,
    decay: float = 0.0,
    segment: float | None = None,
    leave_out: str | list[tuple[str, int]] = (),
) -> xr.Dataset:
    """Frequency response functions of a test with a hammer, with shakers, or under a motion of the base.

    Parameters
    ----------
    excitation : array_like or DataArray (reference, blow, time), str or list of str
        Forces [N] or accelerations of the base [m/s^2]; (blow, time) of one place; (reference, time), (time,)
        of long records. Names are those of channels in `response`.
    response : array_like or DataArray (reference, blow, response, time)
        Or (blow, response, time), (response, time), (time,): without their dimension references act at the
        same time. Blows of NaN are missing. DataArrays have these dimensions in any order, or (sensor, time).
    dt, fs : float, optional
        Sampling interval [s] or rate [Hz], positive; a coordinate `time` states it.
    method : str
        "H1": the noise is in the response. "H2": in the excitation. "Hv": alike in both.
    units : str, optional
        "(m/s^2)/N" (of bare arrays the default), "(m/s)/N", "m/N"; with "/(m/s^2)" in place of "/N" under a
        motion of the base. `units` of DataArrays state it.
    band : tuple of float, optional
        (from, to) [Hz], all lines above 0 by default.
    decay : float
        sigma of an exponential window exp(-sigma t) over excitation and response [1/s]. It is stored, not
        corrected for: models evaluated at sigma + 2 pi i f need no correction.
    segment : float, optional
        Duration [s] of Hann windows, half over each other, in long records. Else a record is an average.
    leave_out : str or list of tuple
        Pairs (reference, number of the blow, from 0), or "doubtful": whatever the warning names.

    Returns
    -------
    xarray.Dataset (response, reference, frequency [Hz])
        `frequency_response`, complex; of more averages than references at a time also `variance`, E|error|^2,
        and `coherence`, the multiple one of several references. `attrs`: `quantity`, `excitation`, `units`,
        `n_averages`, the least of a reference, `duration` of a record or segment [s], `dt` [s],
        `decay` [1/s], `window` of segments, and `blow`, the centroid of the blow [s], NaN where there is
        none; the coordinate `blow` has each.

    Raises
    ------
    ValueError, TypeError
        If shapes, units or times contradict each other, or references are not independent of each other.

    Warns
    -----
    ChannelWarning
        If a blow hits twice, or a channel is overloaded (clipped).

    Notes
    -----
    Lines under a window, or of records that end in zeros (padding), are correlated, and a likelihood that
    counts each would be too narrow: `variance` is E|error|^2 of a line times `variance.attrs["factor"]`,
    1/mean(w^2) of blows and mean(w^4)/mean(w^2)^2 = 1.94 of segments, 1 without window and padding.

    `variance` says nothing of bias: noise of the excitation moves H1 by the factor coherence, that of the
    response H2 by its inverse. A blow cut at T leaks, which a model repeats by `duration` and `blow`. In
    segments of T under white noise the peak of a mode is low by (4/3)/(B T)^2, B = 2 zeta f: 1 % at B T = 12.

    References
    ----------
    Bendat, J. S. and Piersol, A. G. (2010), Random Data, 4th ed., Wiley, sections 6.1 (H1, coherence), 7.1
    (several inputs), 9.2 (errors), 11.5 (windows, overlap). Rocklin, G. T., Crowley, J. and Vold, H. (1985),
    A comparison of the H1, H2 and Hv frequency response functions, Proc. 3rd IMAC.

    Examples
    --------
    >>> force = np.array([[0.0, 1.0, 4.0, 1.0, 0.0, 0.0], [0.0, 2.0, 8.0, 2.0, 0.0, 0.0]])  # on 2 kg
    >>> frf = frequency_response(force, force[:, None] / 2.0, fs=6.0)
    >>> frf["frequency_response"].values.real.round(12).ravel()
    array([0.5, 0.5, 0.5])
    """
    checks.check_choice(method, "method", ("H1", "H2", "Hv"))
    decay = checks.check_positive(decay, "decay", "Pass 1/s.", allow_zero=True)
    step = checks.step_or_rate(dt, fs)
    records, labels, step, pair, together = _prepared(excitation, response, step, units)
    forces, motions = records
    forces = forces.transpose(2, 1, 0, 3) if together else forces  # (set-up, blow, reference, time)
    setups, n_times = [", ".join(labels[0])] if together else labels[0], forces.shape[3]
    what = "of the references, blows and samples of `excitation`"
    same = (len(setups), *forces.shape[1::2]) == (motions.shape[0], *motions.shape[1::2])
    require(same, message("response", what, f"{motions.shape} beside {forces.shape}"))
    one = method == "H1" or forces.shape[2] == 1
    require(one, message("method", "H1 where several references act at the same time", method))
    there = ~(np.isnan(forces).all((2, 3)) | np.isnan(motions).all((2, 3)))  # (set-up, blow)
    for name, values in (("excitation", forces), ("response", motions)):
        checks.check_finite(values[there], name, "NaN is for whole blows that are missing.")
    loud = np.abs(forces) > HIT * np.abs(forces).max(-1, keepdims=True)
    is_blow = segment is None and forces.shape[2] == 1 and loud[there].mean() < SHORT
    there &= ~_left_out(leave_out, setups, there, forces, motions, loud & is_blow)
    if segment is None:
        size, n_used = n_times, 1 + np.flatnonzero((motions[there] != 0.0).any((0, 1))).max(initial=0)
        window, overlap = np.exp(-decay * step * np.arange(size)), 0.0
        factor = size / (window[:n_used] ** 2).sum()  # behind what is used are zeros
    else:
        n_used = size = round(checks.check_positive(segment, "segment", "Pass seconds.") / step)
        what = f"8 samples or more within {n_times * step:g} s, and without `decay`"
        fits = 8 <= size <= n_times and not decay
        require(fits, message("segment", what, f"{segment:g} s and {decay:g} 1/s"))
        window, (factor, overlap) = 0.5 - 0.5 * np.cos(2.0 * np.pi / size * np.arange(size)), HANN
    frequency = np.fft.rfftfreq(size, step)
    low, high = (0.5 * frequency[1], np.inf) if band is None else check_band(band, step)
    lines = (low <= frequency) & (frequency <= high)
    what = f"wider than {frequency[1]:g} Hz between lines"
    require(lines.any(), message("band", what, f"({low:g}, {high:g})"))
    counts, estimates = [], []
    for k, used in enumerate(there):
        X, Y = (windowed_spectra(values[k, used], window)[..., lines] for values in (forces, motions))
        counts.append(len(X))
        estimates.append(_estimate(X, Y, frequency[lines], method, factor, overlap, setups[k]))
    H, *rest = (np.concatenate(parts, axis=1) for parts in zip(*estimates, strict=True))
    facts = {"n_averages": min(counts), "duration": float(n_used * step), "dt": step, "decay": decay}
    facts |= {} if segment is None else {"window": "hann"}
    data = dataset(H, labels, frequency[lines], pair, **facts)
    if is_blow:
        pulses = np.abs(forces * loud)[:, :, 0]
        at = step * (pulses @ np.arange(n_times) / np.maximum(pulses.sum(-1), np.finfo(float).tiny))
        instants = np.array([row[used].mean() for row, used in zip(at, there, strict=True)])
        data = data.assign_attrs(blow=float(instants.mean()))
        data = data.assign_coords(blow=("reference", instants, {"units": "s"}))
    if min(counts) > forces.shape[2]:
        dims = data["frequency_response"].dims
        data["variance"], data["coherence"] = (dims, rest[0], {"factor": float(factor)}), (dims, rest[1])
    return data


def dataset(values, labels, frequency, pair, **facts) -> xr.Dataset:
    """Functions (response, reference, frequency), labels of references and responses, facts of the test."""
    attrs = {"quantity": QUANTITIES[pair[1]], "excitation": EXCITATIONS[pair[0]], "n_averages": 0}
    attrs |= {"duration": np.nan, "dt": np.nan, "decay": 0.0, "blow": np.nan} | facts
    attrs["units"] = next(text for text, units in RATIOS.items() if units == tuple(pair))
    coords = {"response": labels[1], "reference": labels[0]}
    coords["frequency"] = ("frequency", frequency, {"units": "Hz"})
    return xr.Dataset({"frequency_response": (("response", "reference", "frequency"), values)}, coords, attrs)


def _prepared(excitation, response, step, units):
    """Arrays (reference, blow, response, time), labels, step [s], units; whether references act together."""
    names = [excitation] if isinstance(excitation, str) else checks.as_list(excitation) or []
    if names and all(isinstance(name, str) for name in names):
        sensors = np.ravel(getattr(response, "coords", {}).get("sensor", [])).tolist()
        what = f"among the channels {sensors} of `response`"
        require({*names} <= {*sensors}, message("excitation", what, names))
        check_array(response, sensors=True, name="response")
        excitation, response = response.sel(sensor=names), response.drop_sel(sensor=names)
    if all("reference" in getattr(values, "indexes", {}) for values in (excitation, response)):
        response = response.sel(reference=excitation["reference"].values)  # which may be in any order
    if units is not None:
        checks.check_choice(units, "units", RATIOS)
    places = ("reference", "time") if np.ndim(response) < 3 else ("reference", "blow", "time")
    steps, records, labels, pair = [] if step is None else [step], [], [], []
    both = (excitation, places, EXCITATIONS), (response, DIMS, QUANTITIES)
    for k, (values, dims, allowed) in enumerate(both):
        name, axis = ("excitation", "reference") if k == 0 else ("response", "response")
        if not isinstance(values, xr.DataArray):
            values = checks.as_numbers(values, name)
            fits = 0 < values.ndim <= len(dims)
            require(fits, message(name, f"an array ({', '.join(dims)})", f"shape {values.shape}"))
            values = xr.DataArray(values, dims=dims[-values.ndim :])
        if "sensor" in {*values.dims, *values.coords}:
            values = values.rename(sensor=axis)
        is_record = "time" in values.dims and {*values.dims} <= {*DIMS}
        require(is_record, message(name, f"an array of {', '.join(DIMS)}", values.dims))
        if "time" in values.coords:
            steps.append(step_of(values, name))
        stated = np.ravel(values.coords.get("units", values.attrs.get("units", [])))
        stated = {*map(str, stated), *([RATIOS[units][k]] if units else [])} or {*list(allowed)[:1]}
        what, is_known = f"those of the {name}, one of {', '.join(allowed)}", stated <= {*allowed}
        require(len(stated) == 1 and is_known, message("units", what, " and ".join(sorted(stated))))
        whole = values.expand_dims([dim for dim in DIMS if dim not in values.dims]).transpose(*DIMS)
        labels.append([str(label) for label in whole[axis].values])
        records.append(whole.values.astype(np.float64, copy=False))
        pair += stated
    same = bool(steps) and max(steps) <= 1.001 * min(steps)
    require(same, message("dt", "given, and that of the coordinates `time`", f"{steps or None} s"))
    step, together = checks.check_positive(steps[0], "dt", "Pass seconds."), "reference" not in values.dims
    return records, labels, step, pair, together


def _left_out(leave_out, setups, there, forces, motions, loud) -> np.ndarray:
    """Which blows (set-up, blow) are not used; warn of those that are doubtful."""
    doubts, word = {}, "blow" if loud.any() else "record"
    for k, n in np.argwhere(there):
        pulses = np.flatnonzero(np.diff(np.r_[False, loud[k, n, 0], False])).reshape(-1, 2)  # begin, end
        gaps = pulses[1:, 0] - pulses[:-1, 1]
        hits = 1 + (gaps > 0.5 * np.diff(pulses).max(initial=0)).sum()  # shorter gaps are noise of one
        over = sum(bool(flat_tops(x)) for x in (*forces[k, n], *motions[k, n]))
        says = [f"{hits} hits"] * int(hits > 1) + [f"{over} of its channels overloaded"] * int(over > 0)
        doubts |= {(setups[k], int(n)): " and ".join(says)} if says else {}
    blows = [(a, n) for a in setups for n in range(there.shape[1])]
    named = doubts if isinstance(leave_out, str) and leave_out == "doubtful" else checks.as_list(leave_out)
    are_there = named is not None and all(isinstance(pair, tuple) and pair in blows for pair in named)
    what = f'"doubtful" or pairs (reference, blow), from {blows[0]} to {blows[-1]}'
    require(are_there, message("leave_out", what, checks.shown(leave_out)))
    if says := [f"{word} {n} of {a!r} has {doubts[a, n]}" for a, n in doubts if (a, n) not in named]:
        warn_channel(f'Doubtful: {"; ".join(says)}. Leave them out by leave_out="doubtful", or by pairs.')
    return np.reshape([pair in named for pair in blows], there.shape)


def _estimate(X, Y, f, method, factor, overlap, place) -> tuple[np.ndarray, ...]:  # noqa: N803  of a line
    """Functions, variances, coherences (response, reference, line) of spectra (average, channel, line)."""
    from scipy.ndimage import uniform_filter1d  # a second to import

    n, m, n_lines = X.shape
    power = np.einsum("nal,nbl->lab", X, X.conj())
    powers = np.einsum("laa->la", power).real
    scale = np.sqrt(np.maximum(powers, ROUNDING * powers.max(0) + np.finfo(float).tiny))
    weak = f[np.linalg.eigvalsh(power / scale[:, None] / scale[:, :, None])[:, 0] < RANK]
    what = f"present at all lines, and of independent references, in {n} averages"
    advice = "Narrow `band`, shorten `segment`, or leave references out."
    require(
        not weak.size, message("excitation", what, f"that of {place} at {checks.listed(weak, 3)} Hz", advice)
    )
    overlap = 1.0 + 2.0 * overlap * (n - 1) / max(n, 1)  # by which segments are fewer
    rest, weights = max(n - m * overlap, 1e-9), np.ones((n, Y.shape[1]))
    width = min(int(np.ceil(LINES * factor / rest)), n_lines)
    for ahead in range(STEPS if n >= MANY and overlap == 1.0 and width < n_lines else 0, -1, -1):
        inverse = np.einsum("np,nal,nbl->plab", weights, X, X.conj(), optimize=True)
        inverse = np.linalg.inv(inverse) if m > 1 else 1.0 / inverse  # a hundred times as fast
        H = np.einsum("np,npl,nal,plab->pbl", weights, Y, X.conj(), inverse, optimize=True)
        residual = np.abs(Y - np.einsum("pbl,nbl->npl", H, X)) ** 2
        unexplained = np.einsum("np,npl->pl", weights, residual)
        noise = uniform_filter1d(unexplained / rest, width)
        if ahead:
            fit = np.einsum("np,nal,plab,nbl->npl", weights, X.conj(), inverse, X, optimize=True).real
            level = residual / np.maximum(noise * (1.0 - fit), np.finfo(float).tiny)
            weights = 1.0 / np.maximum(level.mean(-1), LEAST)
    total = np.maximum(np.einsum("np,npl->pl", weights, np.abs(Y) ** 2), np.finfo(float).tiny)[:, None]
    coherence = np.broadcast_to(1.0 - unexplained[:, None] / total, H.shape)
    shape, noise = np.einsum("plaa->pal", inverse).real, noise[:, None]
    if method != "H1":  # noise that is smooth in the excitation, or relative to the function
        H = H / coherence if method == "H2" else H / np.sqrt(coherence)
        shape = np.abs(H) ** 4 / total if method == "H2" else np.abs(H) ** 2
        noise = uniform_filter1d(np.abs(H) ** 2 * (1.0 / coherence - 1.0) / (rest * shape), width)
    return H, factor * overlap * noise * shape, coherence
