"""One page that moves, from a saved result alone: a single HTML file without other files or a network.

Its words and tables are those of the attribute `document`, see `report.document`; its scripts draw what
`payload_of` finds in the groups: arrays are packed as short whole numbers, and thinned to what an eye sees. A
new figure is a function here, named in `payload_of`, a `figure` in `templates/figures.js`, and its place in
`templates/report.html`. plotly's own script is embedded once.
"""

import base64
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features.modal.data import mac
from pymc_features.storage import write_atomically
from pymc_features.update.templates import TEMPLATES, numbers

BUDGET = 950_000  # characters of all responses and their spectra
DRAWS = 600  # in the pair plot
GHOSTS, MOST_GHOSTS = 60_000, 24  # entries of mode shapes of draws, and draws
QUANTILES = (0.05, 0.5, 0.95)
SPECTRUM = 300  # frequencies of a spectrum that are drawn
WIDE = 10.0  # of the 99 % quantile of a prior over its median, for a logarithmic axis
RECORD = 1500  # samples of the motion of the base


def write_page(source, out=None) -> Path:
    """Make the page of a saved `update.nc` again, beside it by default; its path."""
    source = Path(source)
    if not source.is_file():
        raise ValueError(f"`RESULT` must be an existing file, got {source}. Name the update.nc of an update.")
    result = read_result(source, "RESULT")
    out = Path(out or source.with_name("report.html"))
    write_atomically(out, lambda path: path.write_text(page_of(result), encoding="utf-8"))
    return out


def read_result(path: Path, argument: str) -> xr.DataTree:
    """A saved result with the words of its report; messages call its path by the argument of a command."""
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            result = tree.load()
    except (OSError, ValueError) as error:
        raise ValueError(f"`{argument}` must be the update.nc of an update, got {path}: {error}") from error
    if "document" not in result.attrs:
        raise ValueError(
            f"`{argument}` must hold the words of its report, {path} has none. Run `pymc-features update` "
            "again: finished likelihoods are kept."
        )
    return result


def page_of(result) -> str:
    document, payload = json.loads(result.attrs["document"]), payload_of(result)
    rows, tables = numbers.rows_of(document), {}
    for one in document["tables"]:
        tables.setdefault(one["section"], []).append(one | {"texts": numbers.columns_of_words(one)})
    shown = [numbers.COLUMNS, *numbers.cells(rows)]
    texts = [k < numbers.N_TEXTS for k in range(len(numbers.COLUMNS))]
    posterior = {"columns": shown[0], "rows": shown[1:], "texts": texts}
    downloads = numbers.files_of(rows) | {"table-as-shown.csv": "\n".join(map(",".join, shown))}
    plotly = files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    shown = {"document": document, "tables": tables, "posterior": posterior, "payload": payload}
    shown |= {"data": in_script(payload), "downloads": in_script(downloads), "plotly": plotly}
    return TEMPLATES.get_template("report.html").render(shown)


def in_script(value) -> str:
    """JSON that cannot end the script it stands in."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


# ---- what the scripts draw, each function the groups of one figure ----


def payload_of(result) -> dict:
    """What the scripts of the page draw."""
    document, units = json.loads(result.attrs["document"]), json.loads(result.attrs["units"])
    rows = numbers.rows_of(document)
    kinds, scales = list(dict.fromkeys(row.kind for row in rows)), numbers.scales_of(rows)
    scales = {name: scales[name] for name in dict.fromkeys(row.name for row in rows) if name in units}
    parameters = {name: {"unit": scale.unit, "factor": scale.factor} for name, scale in scales.items()}
    samples, factor, shared = measured(result, [result[kind] for kind in kinds])
    found = {"kinds": kinds, "parameters": parameters, "of": {}} | shared
    for kind in kinds:
        part, of_kind = result[kind], [row for row in rows if row.kind == kind]
        own = {name: scale.factor for name, scale in scales.items() if name in part["posterior"]}
        found["of"][kind] = {
            "parameters": densities(part, own, of_kind),
            "draws": draws_of(part, own),
            "responses": responses(part, samples, factor) if "bands" in part.children else None,
            "modes": modes_of(part, result, len(kinds)) if "mode_shapes" in part.children else None,
            "singular_values": fitted_values(part) if "spectra" in part.children else None,
            "events": events_of(part, own) if "sequence" in part.children else None,
            "stages": stages_of(part) if "sample_stats" in part.children else None,
            "ranks": ranks_of(part, own, of_kind) if part["posterior"].sizes["chain"] > 1 else None,
        }
        if "modal" in part.children:
            values = part["modal"]["natural_frequency"].values
            quantiles = np.nanquantile(values.reshape(-1, values.shape[-1]), QUANTILES, axis=0).T
            found["of"][kind]["frequencies"] = rounded(quantiles)
            found["of"][kind]["frequency_texts"] = [numbers.interval_texts(row, "Hz")[1] for row in quantiles]
    if "geometry" in result.children:
        found["geometry"] = geometry(result)
    if "data" in result.children and "gain" in result["data"]:
        found["data"] = data_of(result, result[kinds[0]])
    if "singular_values" in result.children:
        found["spectra"] = channel_values(result)
    if of_motions := predicted(result):
        found["predicted"] = of_motions
    return found


def densities(part, factors, rows) -> dict:
    """Densities of posterior and prior, each to its own height, and the 5, 50 and 95 % quantiles."""
    found, quantiles = {}, {row.name: np.array([row.q05, row.q50, row.q95]) for row in rows}
    for name, factor in factors.items():
        prior = part["prior"][name].values / factor
        is_wide = bool(prior.min() > 0.0 and np.quantile(prior, 0.99) > WIDE * np.median(prior))
        of_prior = density(np.log10(prior) if is_wide else prior)
        columns = *density(part["posterior"][name].values / factor), *of_prior
        found[name] = dict(zip(("x", "y", "prior_x", "prior_y"), map(packed, columns), strict=True))
        found[name] |= {"is_log": is_wide, "quantiles": rounded(quantiles[name] / factor, 9)}
    return found


def draws_of(part, factors) -> dict:
    """Draws of the pair plot: first those whose responses are known, then others, evenly spaced."""
    posterior, known = part["posterior"].to_dataset(), []
    size, total = posterior.sizes["draw"], posterior.sizes["draw"] * posterior.sizes["chain"]
    if "histories" in part.children:
        labels = part["histories"].to_dataset()
        at = [posterior.get_index(dim).get_indexer(labels[dim].values) for dim in ("chain", "draw")]
        known = (at[0] * size + at[1]).tolist()
    others = np.linspace(0, total - 1, min(DRAWS, total)).astype(int).tolist()
    chosen = list(dict.fromkeys([*known, *others]))[:DRAWS]
    flat = {name: posterior[name].transpose("chain", "draw").values.ravel()[chosen] for name in factors}
    values = [packed(flat[name] / factor) for name, factor in factors.items()]
    return {"names": list(factors), "values": values, "known": len(known)}


def top_of(part) -> float:
    """Up to which frequency [Hz] spectra are drawn: a little above the tenth mode, or the last."""
    if "modal" not in part.children:
        return np.inf
    values = part["modal"]["natural_frequency"].values[..., :10]
    return 1.5 * float(np.nanmax(np.nanmedian(values, axis=(0, 1))))


def measured(result, parts) -> tuple[list, float, dict]:
    """Samples of each sensor to draw, extremes of measurement and first residual; and what was measured."""
    if "bands" not in parts[0].children:
        return [], 1.0, {}
    observed = parts[0]["observed_data"]["y"]
    values, time = observed.values, observed["time"].values
    median = parts[0]["bands"]["response"].sel(quantile=0.5).values
    components = [part["histories"].sizes["component"] for part in parts]
    size = 4.0 / 3.0 * (4 + sum(2 + 4 + n for n in components))  # characters of a sample of one sensor
    of_spectra = 8.0 / 3.0 * 4 * SPECTRUM * len(parts)
    n = int((BUDGET / len(values) - of_spectra) / size)
    samples = [extremes([y, y - m], n) for y, m in zip(values, median, strict=True)]
    scale = numbers.scale_of(float(np.nanmax(np.abs(values))), observed.attrs.get("units", "-"))
    found = {
        "unit": scale.unit,
        "sensors": observed["sensor"].values.astype(str).tolist(),
        "time": [packed(time[kept]) for kept in samples],
        "values": [packed(y[at] / scale.factor) for y, at in zip(values, samples, strict=True)],
        "samples": [int(time.size), max(map(len, samples))],
    }
    if "displacement" in result["data"]:
        displacement = result["data"]["displacement"].values
        found["displacement"] = [packed(1e3 * displacement[kept]) for kept in samples]
    return samples, scale.factor, {"measured": found}


def responses(part, samples, factor) -> dict:
    """Median, bands as distances from it, components of draws, and spectra, of each sensor."""
    bands, kept = part["bands"].to_dataset(), part["histories"].to_dataset()
    observed, time = part["observed_data"]["y"], bands["time"].values
    found, top = [], top_of(part)
    for k, at in enumerate(samples):
        of_one, y = bands.isel(sensor=k), observed.values[k] / factor
        low, median, high = of_one["response"].values / factor
        distances = {"low": median - low, "high": high - median}
        if "predictive" in bands:
            first, _, last = of_one["predictive"].values / factor
            distances |= {"data_low": median - first, "data_high": last - median}
        frequency, root = spectra([y, median, y - median], time[1] - time[0], top)
        found.append(
            {name: packed(values[at], 8) for name, values in distances.items()}
            | {"median": packed(median[at]), "frequency": packed(frequency), "spectra": log_packed(root)}
            | {"components": [packed(row[at] / factor, 8) for row in kept["component"].values[:, k]]}
        )
    coefficients = rounded(kept["coefficient"].values, 4)
    return {"sensors": found, "coefficients": coefficients, "share": rounded(kept.attrs["share"], 4)}


def geometry(result) -> dict:
    places = result["geometry"].to_dataset()
    found = {name: rounded(places[name].values, 5) for name in ("place", "direction")}
    attrs = {name: json.loads(places.attrs[name]) for name in ("lines", "sensors")}
    return found | attrs | {"style": places.attrs["style"]}


def modes_of(part, result, n_kinds) -> dict:
    """Shapes of the model at some draws, identified ones with their partners, and the MAC of both."""
    shapes, frequencies = (part["mode_shapes"][name].values for name in ("shape", "frequency"))
    n = max(1, min(MOST_GHOSTS, GHOSTS // (shapes[0].size * n_kinds)))
    some = np.unique(np.linspace(0, len(shapes) - 1, n).astype(int))  # the first is in the middle
    found = {"shapes": packed(shapes[some], 8), "frequencies": rounded(frequencies[some], 5)}
    if "matched" not in part.children or "shape" not in result["identified"]:
        return found
    identified, matched = result["identified"].to_dataset(), part["matched"].to_dataset()
    points = json.loads(result["geometry"].attrs["channels"])
    at_channels = shapes[:, : identified.attrs["n_modes"]][..., points]
    agreement = [mac(identified["shape"].values, one) for one in at_channels]
    of_both = {
        "names": matched["label"].values.astype(str).tolist(),
        "partners": matched["partner"].values.tolist(),
        "frequencies": rounded(identified["frequency"].values, 5),
        "shapes": rounded(identified["shape"].values.real, 4),
        "points": points,
        "mac": rounded(np.median(agreement, axis=0), 4),
    }
    return found | {"identified": of_both}


def fitted_values(part) -> dict:
    """Singular values of the spectra that the model makes: 5, 50 and 95 %."""
    fitted = part["spectra"].to_dataset()
    return {"frequency": packed(fitted["frequency"].values), "values": log_packed(fitted["response"].values)}


def channel_values(result) -> dict:
    """Singular values of the spectra of the channels, the bands that are compared, and identified modes."""
    spectrum = result["singular_values"].to_dataset()
    values = spectrum["singular_value"].values
    kept = extremes(np.log(values[:1]), 1200)
    found = {"frequency": packed(spectrum["frequency"].values[kept]), "values": log_packed(values[:, kept])}
    if "identified" in result.children:
        found["identified"] = rounded(result["identified"]["frequency"].values, 5)
    return found | {"bands": rounded(spectrum["band"].values, 5)}


def events_of(part, factors) -> dict:
    """Mean and 90 % interval of each parameter after each event, and the alarms."""
    record = part["sequence"].to_dataset()
    names = [name for name in record["parameter"].values.astype(str) if name in factors]
    chosen = record.sel(parameter=names).transpose("parameter", "event", ...)
    scale = np.array([[factors[name]] for name in names])
    return {
        "names": names,
        "events": record["name"].values.astype(str).tolist(),
        "mean": rounded(chosen["mean"].values / scale),
        "half": rounded(1.645 * chosen["standard_deviation"].values / scale),
        "alarm": (record["alarm"].values > 0).tolist(),
    }


def stages_of(part) -> dict | None:
    """Inverse temperature or tolerance, and acceptance, of each stage of each chain."""
    stats = part["sample_stats"].to_dataset()
    name = next((n for n in ("epsilon", "beta") if n in stats and "stage" in stats[n].dims), None)
    if name is None or stats.sizes["stage"] < 2:
        return None
    accept = stats["accept_rate"].values if "accept_rate" in stats else np.empty((0, 0))
    return {"name": name, "values": rounded(stats[name].values), "accept": rounded(accept, 4)}


def ranks_of(part, factors, rows) -> dict:
    """Ranks of the draws of each chain among all, less what is expected, and 95 % of chains that agree."""
    posterior = part["posterior"].to_dataset()
    effective, found = {row.name: row.ess / posterior.sizes["chain"] for row in rows}, {}
    for name in factors:
        places, shares = rank_differences(posterior[name].transpose("chain", "draw").values)
        half = 1.96 * np.sqrt(places * (1.0 - places) / max(effective[name], 1.0))
        found[name] = {"shares": [packed(row) for row in shares], "half": packed(half), "u": packed(places)}
    return found


def data_of(result, part) -> dict:
    """Motion of the base, gain of the sensors against it, and frequencies that are known."""
    data = result["data"].to_dataset()
    base, frequency = data["ground_acceleration"].values, data["frequency"].values
    shown = (frequency > 0.0) & (frequency <= top_of(part))
    frequency, gain = frequency[shown], data["gain"].values[:, shown]
    kept = extremes(base, RECORD)
    at = extremes(np.log(np.maximum(np.sqrt((gain**2).mean(axis=0)), 1e-12)), 500)
    found = {
        "name": str(data.attrs["record"]),
        "time": packed(data["record_time"].values[kept]),
        "base": packed(base[kept]),
        "frequency": packed(frequency[at]),
        "gain": log_packed(gain[:, at]),
        "peaks": rounded(data["peak_frequency"].values, 5),
    }
    if "given_frequency" in data:
        found["given"] = rounded(data["given_frequency"].values, 5)
    return found


def predicted(result) -> list[dict]:
    """Find of each response to another motion the history where it is largest, peaks of draws, and limits."""
    found = []
    for title, data, name in numbers.predicted_quantities(result):
        peak, label = data[f"{name}_peak"], name.replace("_", " ")
        dims = [dim for dim in peak.dims if dim != "sample"]
        at = {dim: int(peak.median("sample").argmax(dim)) for dim in dims}
        values = data[name].isel(at)
        quantiles = values.transpose("quantile", "time").values
        scale = numbers.scale_of(float(np.abs(quantiles).max()), values.attrs["units"])
        kept = extremes(quantiles[[0, -1]], RECORD)
        columns = ("limit", "probability_any", "probability_any_se")
        limits = [data.get(f"{name}_{column}", xr.DataArray([])).values for column in columns]
        found.append(
            {
                "motion": title,
                "label": label,
                "place": ", ".join([label, *(f"{dim} {values[dim].item()}" for dim in dims)]),
                "unit": scale.unit,
                "time": packed(values["time"].values[kept]),
                "quantiles": packed(quantiles[:, kept] / scale.factor),
                "peaks": packed(np.sort(peak.max(dims).values) / scale.factor),
                "limits": rounded(limits[0] / scale.factor),
                "probabilities": rounded(limits[1]),
                "errors": rounded(limits[2]),
            }
        )
    return found


# ---- arrays ----


def packed(values, bits: int = 16) -> dict:
    """An array as whole numbers in base64: value = low + step (n + half), the smallest n where it is NaN.

    The error is at most half a step, 1/131,000 of the range with 16 bits and 1/500 with 8.
    """
    values = np.asarray(values, dtype=float)
    known = values[np.isfinite(values)]
    half = 2 ** (bits - 1) - 1
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / (2 * half) or 1.0
    whole = np.rint((values - low) / step) - half
    whole = np.where(np.isfinite(values), whole, -half - 1).astype(f"<i{bits // 8}")
    text = base64.b64encode(whole.tobytes()).decode("ascii")
    return {"b": text, "bits": bits, "low": rounded(low, 9), "step": rounded(step, 9), "shape": values.shape}


def rounded(value, digits: int = 6):
    """Numbers, nested as they are, with so many digits; None for NaN."""
    if isinstance(value, list | tuple | np.ndarray):
        return [rounded(item, digits) for item in value]
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def extremes(rows, n: int) -> np.ndarray:
    """Indices of about n samples of some series: in equal parts those where one is largest or smallest.

    All of them if they are no more. What is drawn between the samples is then as high and as low as with all.
    """
    rows = np.nan_to_num(np.atleast_2d(rows))
    size = rows.shape[1]
    each = 2 * len(rows)
    if size <= max(n, each):
        return np.arange(size)
    starts = np.linspace(0, size, max(1, n // each) + 1).astype(int)
    kept = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        part = rows[:, first:last]
        kept.append(first + np.unique([part.argmin(axis=1), part.argmax(axis=1)]))
    return np.concatenate(kept)


def density(values, n: int = 128) -> tuple[np.ndarray, np.ndarray]:
    """Places and density of draws, 0.1 to 99.9 % of them, by ArviZ's kernel that is mirrored at the ends."""
    from arviz_stats.base import array_stats  # slow to import

    values = np.ravel(values)
    low, high = np.quantile(values, [0.001, 0.999])
    if not high > low:
        return np.array([low]), np.array([1.0])
    places, heights, _ = array_stats.kde(values[(values >= low) & (values <= high)], grid_len=n)
    return places, heights / heights.max()


def spectra(rows, step: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and root of the spectral densities (row, frequency) by Welch's method, gaps zero."""
    from scipy import signal  # a second to import

    rows = np.nan_to_num(rows)
    size = rows.shape[1]
    frequency, power = signal.welch(rows, 1.0 / step, nperseg=min(size, max(256, size // 4)))
    shown = (frequency > 0.0) & (frequency <= top)
    frequency, root = frequency[shown], np.sqrt(power[:, shown])
    kept = extremes(np.log(np.maximum(root, 1e-300)), SPECTRUM)
    return frequency[kept], root[:, kept]


def log_packed(values) -> dict:
    """Positive values by their logarithms; nothing where they are zero."""
    with np.errstate(divide="ignore"):
        logs = np.log10(np.asarray(values, dtype=float))
    return packed(np.where(np.isfinite(logs), logs, np.nan)) | {"log": True}


def rank_differences(draws, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Fractional ranks u, and for each chain (chain, draw) the share of its ranks below u, less u."""
    chains, size = draws.shape
    ranks = (draws.ravel().argsort().argsort().reshape(chains, size) + 0.5) / draws.size
    places = np.linspace(0.0, 1.0, n)
    shares = [np.searchsorted(np.sort(row), places) / size - places for row in ranks]
    return places, np.array(shares)
