"""What columns and variables with modes are called, and what their numbers are in Hz and fractions."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pymc_features._checks import message, shown
from pymc_features.io.reading.labels import BRACKETS, without_brackets
from pymc_features.modal.data import listed

#: Words that a label begins with -> quantity.
WORDS = {
    ("damping", "ratios"): "damping",
    ("damping", "ratio"): "damping",
    ("mode", "shapes"): "shapes",
    ("mode", "number"): "mode",
    ("shapes", "imaginary"): "shapes_imaginary",
    ("frequencies",): "frequency",
    ("frequency",): "frequency",
    ("freq",): "frequency",
    ("f",): "frequency",
    ("fn",): "frequency",
    ("zeta",): "damping",
    ("xi",): "damping",
    ("omega",): "omega",
    ("eigenvalues",): "eigenvalue",
    ("eigenvalue",): "eigenvalue",
    ("damping",): "damping",
    ("shapes",): "shapes",
    ("shape",): "shapes",
    ("channels",): "channels",
    ("mode",): "mode",
}
#: Unit of a label, without blanks -> what the quantity is in this unit.
UNITS = {
    "frequency": {"": "frequency", "hz": "frequency", "rad/s": "omega"},
    "omega": {"": "omega", "rad/s": "omega"},
    "eigenvalue": {"": "eigenvalue", "rad^2/s^2": "eigenvalue", "(rad/s)^2": "eigenvalue"},
    "damping": {"": "damping", "-": "damping", "%": "damping_percent", "percent": "damping_percent"},
}
SPREADS = ("sd", "std")
ALIKE = 0.75  # of the letters: a misspelt quantity rather than a name of its own
PER_MODE = ("frequency", "omega", "eigenvalue", "damping", "damping_percent")
NAMES = (
    *PER_MODE,
    *(f"{name}_sd" for name in PER_MODE),
    "shapes",
    "shape_sd",
    "shapes_imaginary",
    "channels",
)

FREQUENCY_LABELS = '"frequency" [Hz], "omega" [rad/s] or "eigenvalue" [rad^2/s^2]'


def quantity_of(label: str, source: str) -> str | None:
    """Which of `NAMES` a label stands for, or "mode"; None if for none of them.

    Examples
    --------
    >>> [quantity_of(label, "") for label in ("Frequency [Hz]", "omega_rad_s", "damping_sd (%)", "roof")]
    ['frequency', 'omega', 'damping_percent_sd', None]
    """
    words = without_brackets(label).lower().replace("_", " ").split()
    spread = [word for word in words if word in SPREADS]
    words = [word for word in words if word not in SPREADS]
    start = next((start for start in WORDS if tuple(words[: len(start)]) == start), None)
    if start is None or len(spread) > 1:
        return None
    base, rest = WORDS[start], "/".join(words[len(start) :])  # "rad s" of omega_rad_s is rad/s
    if base in UNITS:
        brackets = "".join("".join(BRACKETS.findall(label)).lower().split())
        if start == ("f",) and not brackets:
            return None  # a channel may be called so
        base = UNITS[base].get(brackets or rest) if not (brackets and rest) else None
        if base is None and brackets:
            raise ValueError(
                f"{source}: units must be {', '.join(u for u in UNITS[WORDS[start]] if u)}, got {label!r}. "
                "Convert the numbers first."
            )
    elif rest:
        return None
    if spread and base in ("channels", "mode", "shapes_imaginary"):
        return None
    return base if base is None or not spread else {"shapes": "shape_sd"}.get(base, f"{base}_sd")


def check_names(names) -> dict[str, str]:
    """The mapping of quantities to what a source calls them."""
    if names is None:
        return {}
    if not isinstance(names, Mapping):
        raise TypeError(message("names", "a mapping of quantities to names in the file", shown(names)))
    for key in names:
        if key not in NAMES:
            raise ValueError(
                f"`names` must have keys among {', '.join(NAMES)}, got {shown(key)}. Its values are what the "
                "file calls them."
            )
    return {key: str(value) for key, value in names.items()}


def labelled_quantities(labels: list[str], names: dict[str, str], source: str) -> dict[str, int]:
    """Places of the quantities among labels: as the caller names them, or else by their own names."""
    found = {}
    for quantity, name in names.items():
        places = [
            index for index, label in enumerate(labels) if name.strip() in (label, without_brackets(label))
        ]
        if len(places) != 1:
            raise ValueError(
                f"`names` must give names of {source} ({listed(labels)}), got {name!r} for {quantity}, which "
                f"is there {len(places)} times. Pass one of these."
            )
        found[quantity] = places[0]
    for index, label in enumerate(labels):
        if index in found.values():
            continue
        quantity = quantity_of(label, source)
        if quantity is None or quantity in names:
            continue
        if quantity in found:
            raise ValueError(
                f"{source}: {quantity} must be there once, got {labels[found[quantity]]!r} and {label!r}. "
                "Leave out one of them."
            )
        found[quantity] = index
    if not {"frequency", "omega", "eigenvalue"} & found.keys():
        raise ValueError(
            f"{source} must have {FREQUENCY_LABELS}, got {listed(labels)}. Rename one, or pass for example "
            'names={"frequency": "..."}.'
        )
    return found


class ModeValues(NamedTuple):
    """Frequencies [Hz] and damping ratios (m,), and their standard deviations where they are known."""

    frequencies: np.ndarray
    frequency_sd: np.ndarray | None
    damping: np.ndarray | None
    damping_sd: np.ndarray | None


def mode_values(found: dict[str, np.ndarray], source: str) -> ModeValues:
    """Frequencies [Hz] and fractions of critical damping from what a source states, by quantity.

    f = omega / (2 pi) = sqrt(lambda) / (2 pi), with sd(f) = sd(lambda) / (8 pi^2 f).
    """
    values = {
        name: _vector(found[name], name, source) for name in found if name.removesuffix("_sd") in PER_MODE
    }
    lengths = {array.size for array in values.values()}
    if len(lengths) > 1:
        sizes = ", ".join(f"{name} {array.size}" for name, array in values.items())
        raise ValueError(
            f"{source}: all must have one number for each mode, got {sizes}. Complete or cut them."
        )
    _check_beside(values, source)
    stated = {}
    for name in ("frequency", "omega", "eigenvalue"):
        if name in values:
            stated[name] = _in_hertz(name, values, source)
    (first, (frequencies, frequency_sd)), *others = stated.items()
    for name, (again, spread) in others:
        if not np.allclose(again, frequencies, rtol=0.01, atol=0.0):
            same = np.allclose(2.0 * np.pi * again, frequencies, rtol=0.01, atol=0.0)
            advice = f"Is {first} in rad/s? Name it omega." if same else "Leave out the wrong one."
            raise ValueError(
                f"{source}: {first} and {name} must agree, got {frequencies[0]:.4g} and {again[0]:.4g} Hz of "
                f"the first mode. {advice}"
            )
        frequency_sd = spread if frequency_sd is None else frequency_sd
    for factor, name in ((1.0, "damping"), (0.01, "damping_percent")):
        if name in values:
            spread = values.get(f"{name}_sd")
            return ModeValues(
                frequencies, frequency_sd, factor * values[name], None if spread is None else factor * spread
            )
    return ModeValues(frequencies, frequency_sd, None, None)


def _check_beside(values, source: str) -> None:
    """Refuse standard deviations of what is not there, and damping in two units."""
    for name in values:
        if name.removesuffix("_sd") not in values:
            raise ValueError(
                f"{source}: {name} must stand beside {name.removesuffix('_sd')}, got {', '.join(values)}. "
                "Name both in one unit."
            )
    if {"damping", "damping_percent"} <= values.keys():
        raise ValueError(
            f"{source}: damping must be there once, got fractions and percent. Leave out one of them."
        )


def _in_hertz(name: str, values: dict[str, np.ndarray], source: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Frequencies [Hz] and their standard deviations."""
    number, spread = values[name], values.get(f"{name}_sd")
    if name == "frequency":
        return number, spread
    if not (number > 0.0).all():
        mode = int(np.argmin(number > 0.0))
        raise ValueError(
            f"{source}: {name} must be positive, got {number[mode]} of mode {mode}. Leave the mode out."
        )
    if name == "omega":
        return number / (2.0 * np.pi), None if spread is None else spread / (2.0 * np.pi)
    frequencies = np.sqrt(number) / (2.0 * np.pi)
    return frequencies, None if spread is None else spread / (8.0 * np.pi**2 * frequencies)


def _vector(values, name: str, source: str) -> np.ndarray:
    """Numbers (m,) of a row, a column or a single number."""
    try:
        array = np.squeeze(np.asarray(values))
        if array.dtype.kind not in "iufO":  # objects are null among numbers
            raise TypeError
        array = np.atleast_1d(array.astype(np.float64))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{source}: {name} must hold real numbers, got {type(values).__name__}.") from None
    if array.ndim != 1 or array.size == 0:
        raise ValueError(
            f"{source}: {name} must have one number for each mode, got shape {array.shape}. Pass `names` if "
            "another variable holds it."
        )
    return array
