"""What columns and variables with modes are called, and `ModalData` of their numbers in Hz and fractions."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pymc_features._checks import is_among, message, require, shown
from pymc_features.io.reading.labels import BRACKETS, without_brackets
from pymc_features.modal.data import COLLINEAR, ModalData, demand, find_channels, listed, refusal, warn_modes

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
_PAIRS = [(tuple(label.split()), name) for name, labels in _LABELS.items() for label in labels]
WORDS = dict(sorted(_PAIRS, key=lambda item: -len(item[0])))
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
    if not isinstance(names, Mapping | None):
        raise TypeError(message("names", "a mapping of quantities to names in the file", shown(names)))
    for key in names or {}:
        what = f"`names` must have keys among {', '.join(NAMES)}"
        demand(key in NAMES, what, shown(key), "Its values are what the file calls them.")
    return {key: str(value) for key, value in (names or {}).items()}


def labelled_quantities(labels: list[str], names: dict[str, str], source: str) -> dict[str, int]:
    """Places of the quantities among labels: as the caller names them, or else by their own names."""
    found = {}
    for quantity, name in names.items():
        places = [k for k, label in enumerate(labels) if name.strip() in (label, without_brackets(label))]
        got = f"{name!r} for {quantity}, which is there {len(places)} times"
        what = f"`names` must give names of {source} ({listed(labels)})"
        demand(len(places) == 1, what, got, "Pass one of these.")
        found[quantity] = places[0]
    for place, label in enumerate(labels):
        quantity = None if place in found.values() else quantity_of(label, source)
        if quantity is not None and quantity not in names:
            first = found.setdefault(quantity, place)
            what, got = f"{source}: {quantity} must be there once", f"{labels[first]!r} and {label!r}"
            demand(first == place, what, got, "Leave out one of them.")
    advice = 'Rename one, or pass for example names={"frequency": "..."}.'
    demand(HERTZ.keys() & found.keys(), f"{source} must have {FREQUENCY_LABELS}", listed(labels), advice)
    return found


def mode_values(found: dict[str, np.ndarray], source: str) -> dict[str, np.ndarray]:
    """Frequencies [Hz], fractions of critical damping and their standard deviations, as of `ModalData`."""
    values = {}
    for name in (name for name in found if name.removesuffix("_sd") in PER_MODE):
        otherwise = f"{source}: {name} must hold real numbers, got {type(found[name]).__name__}."
        values[name] = np.atleast_1d(np.squeeze(numbers_in(found[name], "iuf", otherwise))).astype(float)
        what, advice = "one number for each mode", "Pass `names` if another variable holds it."
        is_row = values[name].ndim == 1 and values[name].size
        demand(is_row, f"{source}: {name} must have {what}", f"shape {values[name].shape}", advice)
    sizes = ", ".join(f"{name} {array.size}" for name, array in values.items())
    same = len({array.size for array in values.values()}) < 2
    demand(same, f"{source}: all must have one number for each mode", sizes, "Complete or cut them.")
    for name in values:
        base = name.removesuffix("_sd")
        what, advice = f"{source}: {name} must stand beside {base}", "Name both in one unit."
        demand(base in values, what, ", ".join(values), advice)
    once = not FRACTIONS.keys() <= values.keys()
    demand(once, f"{source}: damping must be there once", "fractions and percent", "Leave out one of them.")
    numbers, stated = {}, {}
    for name, (in_hertz, slope) in HERTZ.items():
        if name in values:
            mode = int(np.argmin(values[name] > 0.0))
            what, got = f"{source}: {name} must be positive", f"{values[name][mode]} of mode {mode}"
            demand(name == "frequency" or values[name][mode] > 0.0, what, got, "Leave the mode out.")
            stated[name] = in_hertz(values[name])
            if f"{name}_sd" in values:
                numbers.setdefault("frequency_sd", values[f"{name}_sd"] / slope(stated[name]))
    (first, frequencies), *others = stated.items()
    for name, again in others:
        same = np.allclose(TURN * again, frequencies, rtol=0.01, atol=0.0)
        advice = f"Is {first} in rad/s? Name it omega." if same else "Leave out the wrong one."
        got = f"{frequencies[0]:.4g} and {again[0]:.4g} Hz of the first mode"
        agree = np.allclose(again, frequencies, rtol=0.01, atol=0.0)
        demand(agree, f"{source}: {first} and {name} must agree", got, advice)
    for name, factor in FRACTIONS.items():
        for stem, key in ((name, "damping_ratios"), (f"{name}_sd", "damping_sd")):
            if stem in values:
                numbers[key] = factor * values[stem]
    return numbers | {"frequencies": frequencies}


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
    rows = {}  # one that is there twice, to the last digit, was copied by mistake
    for mode, shape in enumerate([] if modal.shapes is None or modal.labels is not None else modal.shapes):
        frequency = modal.frequencies[mode]
        first = rows.setdefault((frequency, shape.tobytes()), mode)
        require(
            first == mode or np.count_nonzero(~np.isnan(shape)) < 2,
            f"{source}: each mode must be there once, got {first + 1} and {mode + 1} of {frequency:.4g} Hz "
            "are identical. Leave one out, or name the mode of each identification in a column `mode`.",
        )
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
        got, advice = "some for frequencies without shapes", "Pass `names` with the shapes."
        demand(channels is None, "`channels` must be left out", got, advice)
        return [], []
    count, own = found["shapes"].shape[1], found.get("channels")
    own = own and [name.strip() for name in own]
    what, right = f"channels must name the {count} rows of shapes", own is None or len(own) == count
    demand(right, what, f"{len(own or [])} names", "Correct one of them.")
    if channels is None:
        return own or [f"channel {k}" for k in range(count)], list(range(count))
    if isinstance(channels, str) or not isinstance(channels, Sequence | np.ndarray | Mapping):
        what = "`channels` must be a sequence of names, or a mapping of names to those in the source"
        raise TypeError(f"{what}, got {channels!r}.")
    names = [str(name).strip() for name in channels]
    if isinstance(channels, Mapping):
        known = {name: k for k, name in enumerate(own or [])} | {k: k for k in range(count)}
        keys = [key.strip() if isinstance(key, str) else key for key in channels.values()]
        others = [*(key for key in keys if not is_among(key, known)), None]
        what = listed(own) if own else f"0 to {count - 1}, without names"
        what = f"`channels` must be among those of the source ({what})"
        demand(len(others) == 1, what, repr(others[0]), "Pass the name or the number (from 0) of one.")
        return [str(name) for name in channels], [known[key] for key in keys]
    if own is not None:
        return names, find_channels(names, own, "the source")
    advice = "Pass a mapping of names to their numbers (from 0) to take some."
    what = f"`channels` must name all {count} channels of shapes without names"
    demand(len(names) == count, what, len(names), advice)
    return names, list(range(count))


def _implausible(modal: ModalData) -> Iterator[str]:
    """What to say of numbers in what is probably another unit."""
    f, ratios, sd, shapes = modal.frequencies, modal.damping_ratios, modal.frequency_sd, modal.shapes
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
                f"an entry of {sizes[mode, -1]:.3g} in the shape of {f[mode]:.4g} Hz is of another "
                f"size than the others, up to {sizes[mode, -2]:.3g}. Is its exponent spoilt?"
            )
    if sd is not None and (sd > SPREAD * f).any():
        mode = int(np.argmax(sd / f))
        yield (
            f"a standard deviation of {sd[mode]:.3g} Hz for a frequency of {f[mode]:.4g} Hz is "
            "implausible. State standard deviations in the unit of the frequencies, not in percent."
        )
