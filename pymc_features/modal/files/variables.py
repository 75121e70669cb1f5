"""Modes in named variables: MATLAB files, JSON, mappings of arrays and results of pyOMA2.

    {"frequency": [1.21, 3.47], "damping": [0.012, 0.010], "channels": ["floor 1", "roof"],
     "shapes": [[0.45, 1.0], [1.0, -0.4]]}

Shapes have a row for each channel and a column for each mode, as mode shapes have in print and in MATLAB.
JSON has no complex numbers: their imaginary parts are `shapes_imaginary`. Entries that were not measured are
null or NaN.

Results of pyOMA2 are read by the attributes that its documentation states; the library is not imported: `Fn`
(m,) [Hz], `Phi` (s, m), and where the algorithm gives them `Xi` (m,), `Fn_std`, `Xi_std` (m,) and `Phi_std`
(s, m). Those of merged set-ups are how much the set-ups scatter.

Pasca, D. P. and Margoni, D. F. (2024), pyOMA2, https://github.com/dagghe/pyOMA2.
"""

import json
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.reading.lines import decoded, shortened
from pymc_features.modal.data import listed, refusal
from pymc_features.modal.files.quantities import (
    ALIKE,
    NAMES,
    labelled_quantities,
    mode_values,
    numbers_in,
    quantity_of,
)

MOST_JSON = 64 * 2**20  # bytes


def read_mat_modes(path: Path, names: dict[str, str]) -> dict:
    """Modes in the variables of a .mat file of any version."""
    return from_variables(load_variables(path), path.name, names)


def read_json_modes(path: Path, names: dict[str, str]) -> dict:
    """Modes in the object of a JSON file."""
    size = path.stat().st_size
    if size > MOST_JSON:
        what = f"{path.name} must have at most {MOST_JSON // 2**20} MiB"
        raise refusal(what, f"{size} bytes", "Save the modes alone, or as .mat.")
    try:
        found = json.loads(decoded(path.read_bytes()), object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{path.name} must be a JSON file, it cannot be read ({shortened(error)}). Correct it."
        ) from None
    if not isinstance(found, dict):
        what = f"{path.name} must hold one JSON object of named arrays"
        raise refusal(what, f"a {type(found).__name__}", "Give them names, frequency among them.")
    for key in found:
        close = get_close_matches(key.lower(), NAMES, 1, ALIKE)
        if (close or not key) and key not in names.values() and quantity_of(key, path.name) is None:
            looks = f"looks like {close[0]}, misspelt" if close else "is no name"
            raise ValueError(
                f"{path.name}: the key {key!r} {looks}. Correct it, rename it, or say by `names` what it is."
            )
    return from_variables(found, path.name, names)


def _once(pairs: list) -> dict:
    """An object whose keys are there once each."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name is there twice")
    return found


def from_variables(variables: Mapping, source: str, names: dict[str, str]) -> dict:
    """Modes in a mapping of names to arrays."""
    labels, contents = [str(label) for label in variables], list(variables.values())
    if labels and all(isinstance(value, Mapping) for value in contents):
        what, advice = f"{source} must hold named arrays", "Pass one of these, read by yourself, instead of"
        raise refusal(what, f"objects inside: {listed(labels)}", f"{advice} the file.")
    places = labelled_quantities(labels, names, source)
    given = {name: contents[place] for name, place in places.items() if name != "mode"}
    found = mode_values(given, source)
    count = found["frequencies"].size
    shapes, imaginary = (_matrix(given, name, count, source) for name in ("shapes", "shapes_imaginary"))
    if imaginary is not None:
        if shapes is None or shapes.shape != imaginary.shape or shapes.dtype.kind == "c":
            what = f"{source}: shapes_imaginary must stand beside real shapes of its size"
            raise refusal(what, "other ones", "Save both parts.")
        shapes = shapes + 1j * imaginary
    found |= {"shapes": shapes, "shape_sd": _matrix(given, "shape_sd", count, source)}
    if (channels := given.get("channels")) is not None:  # a list, or the rows of a text
        found["channels"] = np.ravel(np.asarray(channels, dtype=object)).tolist()
        if not all(isinstance(name, str) for name in found["channels"]):
            got = type(channels).__name__
            raise refusal(f"{source}: channels must be texts", got, "Pass `channels` instead.")
    return found


def _matrix(found, name: str, n_modes: int, source: str) -> np.ndarray | None:
    """Entries (mode, channel) of a matrix (channel, mode), or of one vector for one mode; None without."""
    if name not in found:
        return None
    what = (
        f"{source}: {name} must be a matrix of numbers with a row for each channel and a column for each mode"
    )
    array = numbers_in(found[name], "iufc", f"{what}, got something else.")
    if array.ndim == 1 and n_modes == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != n_modes:
        turned = array.ndim == 2 and array.shape[0] == n_modes
        advice = "Transpose it." if turned else "Pass `names` if another variable holds them."
        what = (
            f"{source}: {name} must have a row for each channel and a column for each of the {n_modes} modes"
        )
        raise refusal(what, f"shape {array.shape}", advice)
    return array.T


# --- results of pyOMA2 -------------------------------------------------------------------------------

OF_OMA = {
    "frequency": "Fn",
    "frequency_sd": "Fn_std",
    "damping": "Xi",
    "damping_sd": "Xi_std",
    "shapes": "Phi",
    "shape_sd": "Phi_std",
}


def is_oma(source) -> bool:
    """Whether an object is a result, or has one or several."""
    if isinstance(source, Mapping):
        return bool(source) and all(hasattr(value, "Fn") for value in source.values())
    return hasattr(source, "Fn") or hasattr(source, "result")


def read_oma(source) -> dict:
    """Modes of a result, of an algorithm that has one, or of merged set-ups."""
    result = source if hasattr(source, "Fn") or isinstance(source, Mapping) else source.result
    name = type(source).__name__
    if isinstance(result, Mapping):
        if len(result) != 1:
            got = f"{name} with {listed([repr(key) for key in result])}"
            raise refusal("`source` must be one result", got, "Pass one, such as source.result[...].")
        [result] = result.values()
    if getattr(result, "Fn", None) is None or getattr(result, "Phi", None) is None:
        got = f"{name} without frequencies or shapes"
        raise refusal("`source` must have picked modes", got, "Call `mpe` of its set-up first.")
    found = {ours: getattr(result, theirs, None) for ours, theirs in OF_OMA.items()}
    return from_variables({ours: values for ours, values in found.items() if values is not None}, name, {})
