"""What of each model class may be compared with another: the same data, the same kind of density, an
evidence."""

import hashlib
import json
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features._checks import as_list, check_group, message, shown
from pymc_features.events.evidence import Evidence, evidence_of

SAMPLE_BOTH = "Pass what `sample` or `sample_smc` returned for each model."


class Candidate(NamedTuple):
    """One model class.

    Attributes
    ----------
    events : list of DataTree
        Its posterior, or those of several events with parameters of their own.
    evidence : Evidence
        ln Z of all data.
    data : tuple of str
        Fingerprints of the data, sorted.
    kinds : tuple of str
        What the likelihoods are densities of, sorted.
    """

    events: list[xr.DataTree]
    evidence: Evidence
    data: tuple[str, ...]
    kinds: tuple[str, ...]


def candidates(models) -> dict[str, Candidate]:
    """Two or more model classes that can be compared."""
    plain = isinstance(models, Mapping) and not isinstance(models, xr.Dataset | xr.DataTree)
    if not plain or len(models) < 2 or not all(isinstance(name, str) for name in models):
        raise TypeError(message("models", "a dict of two or more posteriors", shown(models), SAMPLE_BOTH))
    found = {name: candidate(name, value) for name, value in models.items()}
    first, *others = found
    for name in others:
        if found[name].data != found[first].data:
            raise ValueError(
                f"`models` must be of the same data, got others for {name} than for {first}. Sample both "
                "with the same channels, window and sampling step."
            )
        if found[name].kinds != found[first].kinds:
            raise ValueError(
                "`models` must have likelihoods that are densities of the same, got "
                f"{', '.join(found[first].kinds)} for {first} and {', '.join(found[name].kinds)} for {name}: "
                "their evidences have other units. Use one likelihood, or density='data' in both."
            )
    return found


def candidate(name: str, value) -> Candidate:
    """One of them."""
    events = [value] if isinstance(value, xr.DataTree) else as_list(value)
    if not events:
        raise TypeError(message("models", "posteriors", f"{shown(value)} for {name}", SAMPLE_BOTH))
    data, kinds = [], []
    for event in events:
        check_group(event, "models", "posterior", SAMPLE_BOTH, "chain", "draw")
        stats = check_group(event, "models", "sample_stats", SAMPLE_BOTH).attrs
        observed = check_group(event, "models", "observed_data", SAMPLE_BOTH)
        if "likelihoods" not in stats:
            wanted = "posteriors that say what their likelihoods are"
            raise ValueError(message("models", wanted, f"none for {name}", SAMPLE_BOTH))
        data += [data_fingerprint(x.values) for x in observed.data_vars.values()]
        kinds += json.loads(stats["likelihoods"]).values()
    evidences = [evidence_of(event) for event in events]
    total = Evidence(
        float(np.sum([e.value for e in evidences])), float(np.linalg.norm([e.error for e in evidences]))
    )
    if not np.isfinite(total).all():
        why = "`calibrate` stretches the likelihood" if "calibration" in events[0].children else "it has none"
        wanted = "posteriors with an evidence and its standard error"
        raise ValueError(message("models", wanted, f"none for {name}: {why}", SAMPLE_BOTH))
    return Candidate(events, total, tuple(sorted(data)), tuple(sorted(set(kinds))))


def data_fingerprint(array) -> str:
    """SHA-256 of the shape and the values of data, whatever their type."""
    array = np.ascontiguousarray(array, dtype=np.float64)
    return hashlib.sha256(repr(array.shape).encode() + array.tobytes()).hexdigest()
