"""What columns and variables with modes are called, and `ModalData` of their numbers in Hz and fractions."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pymc_features._checks import message, shown
from pymc_features.io.reading.labels import BRACKETS, without_brackets
from pymc_features.modal.data import COLLINEAR, ModalData, find_channels, listed, refusal, warn_modes

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
TURN = 2.0 * np.pi
#: What frequencies may be stated as -> f [Hz] of such numbers, and their slope with f.
HERTZ = {
    "frequency": (lambda x: x, lambda f: 1.0),
    "omega": (lambda x: x / TURN, lambda f: TURN),
    "eigenvalue": (lambda x: np.sqrt(x) / TURN, lambda f: 8.0 * np.pi**2 * f),
}
FRACTIONS = {"damping": 1.0, "damping_percent": 0.01}  # of critical, of such numbers
PER_MODE = (*HERTZ, *FRACTIONS)
SPREADS = ("sd", "std")
NAMES = *PER_MODE, *(f"{name}_sd" for name in PER_MODE), "shapes", "shape_sd", "shapes_imaginary", "channels"
ALIKE = 0.75  # of the letters: a misspelt quantity rather than a name of its own

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
            units = ", ".join(unit for unit in UNITS[WORDS[start]] if unit)
            raise refusal(f"{source}: units must be {units}", repr(label), "Convert the numbers first.")
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
            what = f"`names` must have keys among {', '.join(NAMES)}"
            raise refusal(what, shown(key), "Its values are what the file calls them.")
    return {key: str(value) for key, value in names.items()}


def labelled_quantities(labels: list[str], names: dict[str, str], source: str) -> dict[str, int]:
    """Places of the quantities among labels: as the caller names them, or else by their own names."""
    found = {}
    for quantity, name in names.items():
        places = [k for k, label in enumerate(labels) if name.strip() in (label, without_brackets(label))]
        if len(places) != 1:
            what = f"`names` must give names of {source} ({listed(labels)})"
            got = f"{name!r} for {quantity}, which is there {len(places)} times"
            raise refusal(what, got, "Pass one of these.")
        found[quantity] = places[0]
    for place, label in enumerate(labels):
        quantity = None if place in found.values() else quantity_of(label, source)
        if quantity is None or quantity in names:
            continue
        if quantity in found:
            got = f"{labels[found[quantity]]!r} and {label!r}"
            raise refusal(f"{source}: {quantity} must be there once", got, "Leave out one of them.")
        found[quantity] = place
    if not HERTZ.keys() & found.keys():
        advice = 'Rename one, or pass for example names={"frequency": "..."}.'
        raise refusal(f"{source} must have {FREQUENCY_LABELS}", listed(labels), advice)
    return found


def mode_values(found: dict[str, np.ndarray], source: str) -> dict[str, np.ndarray]:
    """Frequencies [Hz], fractions of critical damping and their standard deviations, as of `ModalData`."""
    values = {
        name: _vector(found[name], name, source) for name in found if name.removesuffix("_sd") in PER_MODE
    }
    if len({array.size for array in values.values()}) > 1:
        sizes = ", ".join(f"{name} {array.size}" for name, array in values.items())
        what = f"{source}: all must have one number for each mode"
        raise refusal(what, sizes, "Complete or cut them.")
    for name in values:
        base = name.removesuffix("_sd")
        if base not in values:
            what = f"{source}: {name} must stand beside {base}"
            raise refusal(what, ", ".join(values), "Name both in one unit.")
    if FRACTIONS.keys() <= values.keys():
        what = f"{source}: damping must be there once"
        raise refusal(what, "fractions and percent", "Leave out one of them.")
    stated, spreads = {}, []
    for name, (in_hertz, slope) in HERTZ.items():
        if name in values:
            numbers = values[name]
            if name != "frequency" and not (numbers > 0.0).all():
                mode = int(np.argmin(numbers > 0.0))
                got = f"{numbers[mode]} of mode {mode}"
                raise refusal(f"{source}: {name} must be positive", got, "Leave the mode out.")
            stated[name] = in_hertz(numbers)
            if f"{name}_sd" in values:
                spreads.append(values[f"{name}_sd"] / slope(stated[name]))
    (first, frequencies), *others = stated.items()
    for name, again in others:
        if not np.allclose(again, frequencies, rtol=0.01, atol=0.0):
            same = np.allclose(TURN * again, frequencies, rtol=0.01, atol=0.0)
            advice = f"Is {first} in rad/s? Name it omega." if same else "Leave out the wrong one."
            got = f"{frequencies[0]:.4g} and {again[0]:.4g} Hz of the first mode"
            raise refusal(f"{source}: {first} and {name} must agree", got, advice)
    numbers = {"frequencies": frequencies, "frequency_sd": spreads[0] if spreads else None}
    for name, factor in FRACTIONS.items():
        for stem, key in ((name, "damping_ratios"), (f"{name}_sd", "damping_sd")):
            if stem in values:
                numbers[key] = factor * values[stem]
    return numbers


def numbers_in(values, kinds: str, otherwise: str) -> np.ndarray:
    """An array of numbers of some kinds, NaN for null; `otherwise` is the error about anything else."""
    try:
        array = np.asarray(values)
        array = array.astype(np.float64) if array.dtype == object else array
        if array.dtype.kind in kinds:
            return array
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(otherwise)


def _vector(values, name: str, source: str) -> np.ndarray:
    """Numbers (m,) of a row, a column or a single number."""
    otherwise = f"{source}: {name} must hold real numbers, got {type(values).__name__}."
    array = np.atleast_1d(np.squeeze(numbers_in(values, "iuf", otherwise))).astype(np.float64)
    if array.ndim != 1 or array.size == 0:
        advice = "Pass `names` if another variable holds it."
        raise refusal(f"{source}: {name} must have one number for each mode", f"shape {array.shape}", advice)
    return array


# ---- what a reader found, arguments of `ModalData`, as the caller asks for it ----

DAMPED = 0.3  # a damping ratio above it is more likely a percentage
ALONE = 30.0  # an entry of a shape this many times the second is more likely spoilt
SPREAD = 0.5  # so is a standard deviation above this fraction of its frequency


def modal_data(source: str, found: dict, channels, real: bool) -> ModalData:
    """The modes with the names and channels that the caller asks for, and real shapes if they shall be."""
    try:
        names, columns = _named(found, channels)
        for name in ("shapes", "shape_sd"):
            if found.get(name) is not None:
                found[name] = np.asarray(found[name])[:, columns]
        modal = ModalData(**found | {"channels": names})
    except (ValueError, TypeError) as error:
        raise type(error)(f"{source}: {error}") from None
    for text in _implausible(modal):
        warn_modes(f"{source}: {text}")
    _refuse_copies(modal, source)
    if not real or not modal.is_complex:
        return modal
    collinearity = modal.phase_collinearity
    low = np.flatnonzero(collinearity < COLLINEAR)
    if low.size:
        modes = ", ".join(f"{modal.frequencies[k]:.4g} Hz: {collinearity[k]:.2f}" for k in low[:8])
        warn_modes(
            f"{source}: the phases of some shapes differ (modal phase collinearity of 1 is in phase; "
            f"{modes}), and their imaginary parts are left out. Leave out modes that are noise, or keep "
            "complex shapes by real=False."
        )
    return modal.real()


def _named(found: dict, channels) -> tuple[list[str], list[int]]:
    """Names of the channels, and their columns in the source."""
    if found.get("shapes") is None:
        if channels is not None:
            what = "`channels` must be left out"
            raise refusal(what, "some for frequencies without shapes", "Pass `names` with the shapes.")
        return [], []
    count = found["shapes"].shape[1]
    own = found.get("channels")
    own = own and [name.strip() for name in own]
    if own is not None and len(own) != count:
        what = f"channels must name the {count} rows of shapes"
        raise refusal(what, f"{len(own)} names", "Correct one of them.")
    if isinstance(channels, Mapping):
        places = {name: k for k, name in enumerate(own or [])}
        return [str(name) for name in channels], [_column(key, places, count) for key in channels.values()]
    if channels is None:
        return own or [f"channel {k}" for k in range(count)], list(range(count))
    if isinstance(channels, str) or not isinstance(channels, Sequence | np.ndarray):
        what = "`channels` must be a sequence of names, or a mapping of names to those in the source"
        raise TypeError(f"{what}, got {channels!r}.")
    names = [str(name).strip() for name in channels]
    if own is not None:
        return names, find_channels(names, own, "the source")
    if len(names) != count:
        advice = "Pass a mapping of names to their numbers (from 0) to take some."
        raise refusal(
            f"`channels` must name all {count} channels of shapes without names", len(names), advice
        )
    return names, list(range(count))


def _column(key, places: dict[str, int], count: int) -> int:
    """The place of a channel, by its name or number in the source."""
    if isinstance(key, str) and key.strip() in places:
        return places[key.strip()]
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and 0 <= key < count:
        return int(key)
    what = listed(list(places)) if places else f"0 to {count - 1}, without names"
    advice = "Pass the name or the number (from 0) of one."
    raise refusal(f"`channels` must be among those of the source ({what})", repr(key), advice)


def _implausible(modal: ModalData) -> Iterator[str]:
    """What to say of numbers in what is probably another unit."""
    frequencies, ratios, sd, shapes = (
        modal.frequencies,
        modal.damping_ratios,
        modal.frequency_sd,
        modal.shapes,
    )
    if ratios is not None and (ratios > DAMPED).any():
        yield (
            f"a damping ratio of {np.nanmax(ratios):.3g} of critical is implausible. "
            "Name it `damping_percent` if that is a percentage."
        )
    if shapes is not None and shapes.shape[1] > 2:
        sizes = np.sort(np.nan_to_num(np.abs(shapes)), axis=1)
        alone = ALONE if shapes.shape[1] > 3 else 10.0 * ALONE  # of three two may be near a node
        for mode in np.flatnonzero(sizes[:, -1] > alone * sizes[:, -2]):
            yield (
                f"an entry of {sizes[mode, -1]:.3g} in the shape of {frequencies[mode]:.4g} Hz is of another "
                f"size than the others, up to {sizes[mode, -2]:.3g}. Is its exponent spoilt?"
            )
    if sd is not None and (sd > SPREAD * frequencies).any():
        mode = int(np.argmax(sd / frequencies))
        yield (
            f"a standard deviation of {sd[mode]:.3g} Hz for a frequency of {frequencies[mode]:.4g} Hz is "
            "implausible. State standard deviations in the unit of the frequencies, not in percent."
        )


def _refuse_copies(modal: ModalData, source: str) -> None:
    """A mode that is there twice, to the last digit, was copied by mistake."""
    if modal.shapes is None or modal.labels is not None:
        return
    rows = {}
    for mode, (frequency, shape) in enumerate(zip(modal.frequencies, modal.shapes, strict=True)):
        first = rows.setdefault((frequency, shape.tobytes()), mode)
        if first != mode and np.count_nonzero(~np.isnan(shape)) > 1:
            got = f"{first + 1} and {mode + 1} of {frequency:.4g} Hz are identical"
            raise ValueError(
                f"{source}: each mode must be there once, {got}. Leave one out, or name the mode of each "
                "identification in a column `mode`."
            )
