"""Responses to other motions of the base under the posterior: [[predict]]."""

from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field, model_validator

from pymc_features.exceptions import ConfigError
from pymc_features.prediction import first_passage_probability, posterior_response
from pymc_features.records import Interpolation, Record
from pymc_features.update.config.entries import Positive, key
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import BETWEEN, QUANTITIES, SOME_QUANTITIES, RecordFile
from pymc_features.update.config.structures import modes_of
from pymc_features.update.kinds.base import QUANTILES, table
from pymc_features.update.templates.numbers import interval_texts, predicted_quantities, scale_of

DRAWS = 500
SAMPLES = 16  # in a period
PREDICTION = "prediction"
COLUMNS = ("motion", "largest", "unit", "5 %", "50 %", "95 %", "limit", "probability")
MEANING = (
    "The largest value at any place, from the uncertainty of the parameters alone; a probability is that of "
    "exceeding the limit anywhere."
)
LIMITS = "a table of quantities to a limit in SI units, or a list of limits, positive"


class Predict(RecordFile):
    """Which motion, which responses, and the limits that they are not to exceed."""

    name: str | None = key("a line of text without /, by default the name of the file", None)
    path: str | None = key("the file with the ground acceleration, or left out for that of [data]", None)
    scale: float = key("a factor of the record, not 0", 1.0)
    peak: float | None = key("the largest acceleration in m/s^2 to scale the record to, positive", None, gt=0)
    quantities: list[QUANTITIES] = key(SOME_QUANTITIES, min_length=1)
    limits: dict[str, Positive | Annotated[list[Positive], Field(min_length=1)]] = key(LIMITS, {})
    draws: int = key("a whole number from 10 on", DRAWS, ge=10)
    interpolation: Interpolation | None = key(BETWEEN, None)

    @model_validator(mode="after")
    def fits(self):
        """Limits are those of the quantities, and one thing decides the scale."""
        if strangers := set(self.limits) - set(self.quantities):
            raise ValueError(
                f"must have `limits` of its quantities {self.quantities}, got {min(strangers)!r}"
            )
        if self.scale == 0.0 or (self.peak is not None and "scale" in self.model_fields_set):
            raise ValueError(f"must have a `scale` that is not 0, or a `peak`, got scale {self.scale:g}")
        of_file = self.model_fields_set & {"units", "dt", "column", "wrapped", "delay"}
        if self.path is None and of_file:
            raise ValueError(f"must have `{min(of_file)}` only with `path`, got no file")
        return self

    @property
    def title(self) -> str:
        found = self.name or ("measured motion" if self.path is None else Path(self.path).stem)
        return found.replace("/", "-")

    def motion(self, folder: Path, measured: Record | None) -> Record:
        record, factor = measured if self.path is None else self.read(folder), self.scale
        if self.peak is not None:
            factor = self.peak / float(np.abs(record.acceleration).max())
        interpolation = self.interpolation or record.interpolation
        return replace(record, acceleration=factor * record.acceleration, interpolation=interpolation)


def check_predictions(config, structure) -> None:
    """Names differ, and structures have what is asked for."""
    predict = {f"predict[{number}]": asked for number, asked in enumerate(config.predict)}
    for at, asked in {"report": config.report, **predict}.items():
        if "inter_storey_drift" in asked.quantities and not structure.has_storeys:
            raise ConfigError(
                f"`{at}.quantities` must not have inter_storey_drift for a structure without storeys, "
                f"{structure.title}. Use relative_displacement."
            )
    titles = [asked.title for asked in config.predict]
    if len(set(titles)) < len(titles):
        raise ConfigError(f"`predict` must have a `name` of its own for each, got {', '.join(titles)}.")
    if config.predict and not structure.has_modes:
        raise ConfigError(f"`predict` must be left out with {structure.title}, got it. It has no base.")
    for at, asked in predict.items():
        if asked.path is None and (config.data is None or config.data.excitation == "ambient"):
            raise ConfigError(f"`{at}.path` must be given, the file of a ground motion: none was measured.")


def substeps(structure, posterior, dt: float) -> int:
    """Into how many steps one of a record is divided, so that samples do not miss the peaks.

    The highest mode at the medians that the record can excite gets `SAMPLES` in a period: its largest sample
    is at most 1 - cos(pi / SAMPLES) below its peak.
    """
    medians = {name: float(np.median(posterior[name])) for name in structure.names}
    frequencies = modes_of(structure(**medians), structure.n_modes).natural_frequencies
    return max(1, ceil(SAMPLES * frequencies[frequencies < 0.5 / dt].max(initial=0.0) * dt))


def predictions(config, folder: Path, structure, posterior, measured: Record | None) -> dict[str, xr.Dataset]:
    """Predict every response that a file asks for under a posterior, perhaps to the measured motion.

    Each title has a Dataset: the motion `ground_acceleration` (record_time); of each quantity q its bands q
    (quantile, storey or sensor, time), the peaks of draws q_peak (sample, ...), and where it has limits
    `q_probability` (q_limit, ...) that the peak exceeds them, `q_probability_any` (q_limit) that any does,
    and their standard errors `..._se`.
    """
    found = {}
    for number, asked in enumerate(config.predict):
        with named_key(f"predict[{number}]"):
            record = asked.motion(folder, measured)
        given = posterior, structure, record
        settings = {"draws": asked.draws, "random_seed": 0, "n_modes": structure.n_modes}
        settings["dt"] = record.dt / substeps(structure, posterior, record.dt)
        data = posterior_response(*given, asked.quantities, quantiles=QUANTILES, **settings)
        data = data.drop_vars(["chain", "draw"])
        data["ground_acceleration"] = "record_time", record.acceleration, {"units": "m/s^2"}
        for name, limits in asked.limits.items():
            limits = np.sort(np.ravel(limits).astype(float))
            of_limits = first_passage_probability(*given, limits, name, **settings)
            for part in ("probability", "probability_se", "probability_any", "probability_any_se"):
                data[f"{name}_{part}"] = of_limits[part].rename(limit=f"{name}_limit")
        found[asked.title] = data.assign_coords(record_time=record.time)
    return found


def predicted_rows(result: xr.DataTree) -> list[dict]:
    """Peaks of each response where it is largest, and for each limit the probability that it is exceeded."""
    rows = []
    for title, data, name in predicted_quantities(result):
        peak = data[f"{name}_peak"]
        largest = peak.max([dim for dim in peak.dims if dim != "sample"])
        quantiles = np.quantile(largest.values, QUANTILES).tolist()
        unit = data[name].attrs["units"]
        row = {"motion": title, "quantity": name.replace("_", " "), "unit": unit, "quantiles": quantiles}
        told = [(None, None, None)]
        if f"{name}_limit" in data:
            columns = ("limit", "probability_any", "probability_any_se")
            told = np.transpose([data[f"{name}_{column}"].values for column in columns]).tolist()
        rows += [row | dict(zip(("limit", "probability", "error"), one, strict=True)) for one in told]
    return rows


def predicted_table(rows: list[dict]) -> dict:
    """Peaks under other motions, and the probabilities that they exceed limits."""
    cells = []
    for row in rows:
        scale = scale_of(max(map(abs, row["quantiles"])), row["unit"])
        unit, texts = interval_texts(row["quantiles"], row["unit"])
        has_limit = row["limit"] is not None
        told = (f"{row['limit'] / scale.factor:.4g}", f"{row['probability']:.3f}") if has_limit else ("", "")
        cells.append((row["motion"], row["quantity"], unit, *texts, *told))
    return table(PREDICTION, PREDICTION, "Largest responses to other motions", COLUMNS, cells, MEANING)
