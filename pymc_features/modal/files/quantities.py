"""What columns and variables with modes are called, and `ModalData` of their numbers in Hz and fractions."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pymc_features._checks import message, shown
from pymc_features.io.reading.labels import BRACKETS, without_brackets
from pymc_features.modal.data import COLLINEAR, ModalData, find_channels, listed, warn_modes

_LABELS = {
    "damping": ("damping ratios", "damping ratio", "damping", "zeta", "xi"),
    "shapes_imaginary": ("shapes imaginary",),
    "shapes": ("mode shapes", "shapes", "shape"),
    "mode": ("mode number", "mode"),
    "frequency": ("frequencies", "frequency", "freq", "f", "fn"),
    "omega": ("omega",),
    "eigenvalue": ("eigenvalues", "eigenvalue"),
    "channels": ("channels",),
}
#: Words that a label begins with -> quantity, several words before one.
WORDS = {tuple(label.split()): name for name, labels in _LABELS.items() for label in labels}
WORDS = dict(sorted(WORDS.items(), key=lambda item: -len(item[0])))
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


# ---- what a reader returns, and how it becomes `ModalData` ----

DAMPED = 0.3  # a damping ratio above it is more likely a percentage
ALONE = 30.0  # an entry of a shape this many times the second is more likely spoilt
SPREAD = 0.5  # so is a standard deviation above this fraction of its frequency


class Identified(NamedTuple):
    """Modes as a source states them, in Hz and fractions; None where it is silent."""

    source: str  # what messages call it: the name of the file
    frequencies: np.ndarray  # (m,), as the next three
    frequency_sd: np.ndarray | None = None
    damping: np.ndarray | None = None
    damping_sd: np.ndarray | None = None
    shapes: np.ndarray | None = None  # (m, s), as the next
    shape_sd: np.ndarray | None = None
    channels: list[str] | None = None
    labels: list[str] | None = None  # which mode each is of, where some are of the same


def modal_data(found: Identified, channels, real: bool) -> ModalData:
    """The modes with the names and channels that the caller asks for, and real shapes if they shall be."""
    try:
        names, columns = _named(found, channels)
        shapes, shape_sd = (
            None if a is None else np.asarray(a)[:, columns] for a in (found.shapes, found.shape_sd)
        )
        modal = ModalData(
            found.frequencies,
            shapes,
            names,
            frequency_sd=found.frequency_sd,
            damping_ratios=found.damping,
            damping_sd=found.damping_sd,
            shape_sd=shape_sd,
            labels=found.labels,
        )
    except (ValueError, TypeError) as error:
        raise type(error)(f"{found.source}: {error}") from None
    _check_plausible(modal, found.source)
    _refuse_copies(modal, found.source)
    if not real or not modal.is_complex:
        return modal
    _check_phases(modal, found.source)
    return modal.real()


def _named(found: Identified, channels) -> tuple[list[str], list[int]]:
    """Names of the channels, and their columns in the source."""
    if found.shapes is None:
        if channels is not None:
            raise ValueError(
                "`channels` must be left out, got some for frequencies without shapes. Pass `names` with "
                "the shapes."
            )
        return [], []
    count = found.shapes.shape[1]
    own = None if found.channels is None else [name.strip() for name in found.channels]
    if own is not None and len(own) != count:
        raise ValueError(
            f"channels must name the {count} rows of shapes, got {len(own)} names. Correct one of them."
        )
    if isinstance(channels, Mapping):
        places = {} if own is None else {name: index for index, name in enumerate(own)}
        return [str(name) for name in channels], [_column(key, places, count) for key in channels.values()]
    if channels is None:
        return (own if own is not None else [f"channel {k}" for k in range(count)]), list(range(count))
    if isinstance(channels, str) or not isinstance(channels, Sequence | np.ndarray):
        raise TypeError(
            "`channels` must be a sequence of names, or a mapping of names to those in the source, got "
            f"{channels!r}."
        )
    names = [str(name).strip() for name in channels]
    if own is not None:
        return names, find_channels(names, own, "the source")
    if len(names) != count:
        raise ValueError(
            f"`channels` must name all {count} channels of shapes without names, got {len(names)}. Pass a "
            "mapping of names to their numbers (from 0) to take some."
        )
    return names, list(range(count))


def _column(key, places: dict[str, int], count: int) -> int:
    """The place of a channel, by its name or number in the source."""
    if isinstance(key, str) and key.strip() in places:
        return places[key.strip()]
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and 0 <= key < count:
        return int(key)
    what = listed(list(places)) if places else f"0 to {count - 1}, without names"
    raise ValueError(
        f"`channels` must be among those of the source ({what}), got {key!r}. Pass the name or the number "
        "(from 0) of one."
    )


def _check_plausible(modal: ModalData, source: str) -> None:
    """Warn of numbers in what is probably another unit."""
    if modal.damping_ratios is not None and (modal.damping_ratios > DAMPED).any():
        warn_modes(
            f"{source}: a damping ratio of {np.nanmax(modal.damping_ratios):.3g} of critical is implausible. "
            "Name it `damping_percent` if that is a percentage."
        )
    if modal.shapes is not None and modal.shapes.shape[1] > 2:
        sizes = np.sort(np.nan_to_num(np.abs(modal.shapes)), axis=1)
        alone = ALONE if modal.shapes.shape[1] > 3 else 10.0 * ALONE  # of three two may be near a node
        for mode in np.flatnonzero(sizes[:, -1] > alone * sizes[:, -2]):
            warn_modes(
                f"{source}: an entry of {sizes[mode, -1]:.3g} in the shape of {modal.frequencies[mode]:.4g} "
                f"Hz is of another size than the others, up to {sizes[mode, -2]:.3g}. Is its exponent spoilt?"
            )
    if modal.frequency_sd is not None and (modal.frequency_sd > SPREAD * modal.frequencies).any():
        mode = int(np.argmax(modal.frequency_sd / modal.frequencies))
        warn_modes(
            f"{source}: a standard deviation of {modal.frequency_sd[mode]:.3g} Hz for a frequency of "
            f"{modal.frequencies[mode]:.4g} Hz is implausible. State standard deviations in the unit of the "
            "frequencies, not in percent."
        )


def _refuse_copies(modal: ModalData, source: str) -> None:
    """A mode that is there twice, to the last digit, was copied by mistake."""
    if modal.shapes is None or modal.labels is not None:
        return
    rows = {}
    for mode, (frequency, shape) in enumerate(zip(modal.frequencies, modal.shapes, strict=True)):
        first = rows.setdefault((frequency, shape.tobytes()), mode)
        if first != mode and np.count_nonzero(~np.isnan(shape)) > 1:
            raise ValueError(
                f"{source}: each mode must be there once, {first + 1} and {mode + 1} of {frequency:.4g} Hz "
                "are identical. Leave one out, or name the mode of each identification in a column `mode`."
            )


def _check_phases(modal: ModalData, source: str) -> None:
    """Warn of shapes whose real part is not all of them."""
    collinearity = modal.phase_collinearity
    low = np.flatnonzero(collinearity < COLLINEAR)
    if low.size:
        modes = ", ".join(f"{modal.frequencies[k]:.4g} Hz: {collinearity[k]:.2f}" for k in low[:8])
        warn_modes(
            f"{source}: the phases of some shapes differ (modal phase collinearity of 1 is in phase; "
            f"{modes}), and their imaginary parts are left out. Leave out modes that are noise, or keep "
            "complex shapes by real=False."
        )
