"""What the label of a column says and what the caller says: units, quantities, what a column is, steps."""

import re
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pymc_features._checks import SAMPLING_INTERVAL, check_positive, message, require, shown, warn_caller

#: Gravity [m/s^2] behind the unit "g", as reference results have it; who wants 9.80665 passes it as `units`.
G = 9.81
INCH, FOOT, POUND = 0.0254, 0.3048, 4.4482216152605  # m, m, N, exact

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": INCH, "ft": FOOT, "nm": 1e-9}
FORCES = {"N": 1.0, "kN": 1e3, "MN": 1e6, "lbf": POUND, "kip": 1e3 * POUND}
MASSES = {"kg": 1.0, "t": 1e3, "Mg": 1e3, "lb": 0.45359237, "slug": POUND / FOOT, "slinch": POUND / INCH}
#: SI units per unit, by quantity. Capitals count where "mN" and "MN" differ, and nowhere else.
UNITS = {
    "acceleration": {"g": G, "mg": 1e-3 * G, "m/s^2": 1.0, "cm/s^2": 0.01, "gal": 0.01, "mgal": 1e-5}
    | {f"{name}/s^2": factor for name, factor in LENGTHS.items()}
    | {"gn": G, "ug": 1e-6 * G, "mps2": 1.0, "ms2": 1.0},
    "velocity": {f"{name}/s": factor for name, factor in LENGTHS.items()}
    | {"kine": 0.01, "km/h": 1.0 / 3.6, "mps": 1.0},
    "displacement": LENGTHS | {"micron": 1e-6, "meter": 1.0},
    "strain": {"m/m": 1.0, "mm/m": 1e-3} | dict.fromkeys(("um/m", "ue", "ustrain", "microstrain"), 1e-6),
    "force": FORCES | {"mN": 1e-3, "kgf": 9.80665, "tf": 9806.65},
    "pressure": {"psi": POUND / INCH**2, "Pa": 1.0, "hPa": 100.0, "kPa": 1e3, "MPa": 1e6}
    | {"bar": 1e5, "mbar": 100.0},
    "voltage": {"V": 1.0, "volt": 1.0, "mV": 1e-3, "uV": 1e-6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
    | {"minute": 60.0, "hr": 3600.0, "hour": 3600.0, "day": 86400.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "1/s": 1.0},
    "temperature": {"degC": 1.0, "°C": 1.0},
    "angular velocity": {"deg/s": 1.0, "°/s": 1.0, "rad/s": 1.0, "dps": 1.0},
    "magnetic field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "gauss": 1e-4},
    "angle": {"deg": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0, "mrad": 1e-3},
}
#: The SI unit of a quantity that sensors measure.
SI = {"acceleration": "m/s^2", "velocity": "m/s", "displacement": "m"}
SI |= {"strain": "m/m", "force": "N", "pressure": "Pa", "voltage": "V"}
PLURALS = {name: f"{name[:-1]}ies" if name.endswith("y") else f"{name}s" for name in SI}
QUANTITIES = tuple(name for name in SI if name != "voltage")  # what a sensor may be asked for
DIRECTIONS = "N", "S", "E", "W", "Z", "H", "U", "X", "Y", "T", "R"
#: Words of a label, in lower case, by what they say that a column is.
ROLES = {
    "acceleration": "a ax ay az acc accel acceleration accelerations accelerometer",
    "time": "t time epoch unix timestamp timestamps date datetime clock elapsed seconds sampletimefine zeit "
    "temps tempo tiempo tid tijd czas",
    "period": "period periods periode",
    "frequency": "frequency frequencies freq frequenz",
    "depth": "depth tiefe",
    "spectral": "sa psa psv",
    "displacement": "displacement disp drift deflection stroke lvdt weg",
    "velocity": "velocity vel geophone",
    "strain": "strain",
    "force": "force load",
    "voltage": "voltage volts",
    "temperature": "temperature temp",
    "angular velocity": "gyro gyr",
    "magnetic field": "magnetometer magn mag",
}
OF_WORD = {word: role for role, words in ROLES.items() for word in words.split()}
MEASURED = {*SI, "temperature", "angular velocity", "magnetic field"}  # roles that are quantities
NUMBERS = {"sample", "samples", "index", "count", "counter", "frame", "record", "no", "number", "nr", "id"}
NO_HISTORY = "period", "frequency", "depth", "spectral"  # of tables over something else than time

BRACKETS = re.compile(r"(?:\[|\((?![^)]*\[))((?:[^\[\]()]|\([^()]*\))*)[\])]")
WORD = re.compile(r"[^\s\[\]()]+(?:\s*[\[(][^\[\]()]*[\])])?|[\[(][^\[\]()]*[\])]")  # and its brackets
_PLAIN = str.maketrans("µμε²¹⁻·*", "uue21-  ", "^(){}'")
_SENSITIVITY = re.compile(r"\s*(\d+\.?\d*(?:[eE][-+]?\d+)?)\s*([^\s/\d]+)\s*(?:/|per)\s*(.+?)\s*")
_SECOND = re.compile(r"sec(?:ond)?s?(?![a-z])", re.IGNORECASE)
_PER_SECOND = re.compile(r"[ .]?s-([12])$", re.IGNORECASE)  # m s-2


class Unit(NamedTuple):
    """A unit: the quantity that it is of, and SI units in it."""

    quantity: str
    factor: float


EXACT = {n.replace("^", ""): Unit(kind, f) for kind, names in UNITS.items() for n, f in names.items()}
LOWER = {name.lower(): unit for name, unit in reversed(EXACT.items()) if name not in ("mN", "MN", "MPa")}


@lru_cache(1024)
def unit_of(text: str | None, *quantities: str) -> Unit | None:
    """The unit that a text is, in any usual spelling, of one of some quantities or of any; else None."""
    text = _SECOND.sub("s", (text or "").replace("**", "").translate(_PLAIN).strip())
    text = re.sub("(?i)^inch", "in", re.sub("(?i)/s/s$", "/s2", text))
    if (inverse := _PER_SECOND.search(text)) and text[: inverse.start()].strip().lower() in LENGTHS:
        text = text[: inverse.start()] + ("/s2" if inverse[1] == "2" else "/s")
    text = text.replace(" ", "")
    one = text[:-1] if len(text) > 2 and text.endswith("s") else text  # minutes, kips
    ways = (text, EXACT), (one, EXACT), (text.lower(), LOWER), (one.lower(), LOWER)
    unit = next((known[way] for way, known in ways if way in known), None)
    return unit if unit is not None and unit.quantity in (quantities or UNITS) else None


def role_of(label: str) -> str | None:
    """What a column is by the words of its label, without brackets; None where they do not say."""
    words = re.split(r"[^a-zA-Z]+", label)
    if not re.search(r"\d", label) and words[0] and {word.lower() for word in words if word} <= NUMBERS:
        return "number"
    return next((OF_WORD[word.lower()] for word in words if word.lower() in OF_WORD), None)


def without_brackets(text: str) -> str:
    """The text without brackets and what stands in them."""
    return BRACKETS.sub("", text).strip()


class Label(NamedTuple):
    """What stands above a column."""

    text: str  # as it stands in the file, without quotation marks
    name: str  # without the unit
    unit: str | None = None  # in brackets, in a row of units, or behind a name of at least two letters

    @property
    def seconds(self) -> float | None:
        """Seconds in the unit, if it is one of time."""
        return unit.factor if (unit := unit_of(self.unit, "time")) else None

    @classmethod
    def of(cls, text: str, unit: str | None = None) -> "Label":
        """The label that a text is, with the unit of a row of units below it."""
        name = without_brackets(text)
        units = [found.strip() for found in BRACKETS.findall(text)]
        if role_of(name) == "acceleration" and units and units[0] in DIRECTIONS:
            name, units = text, []  # acc (N) is that to the north
        known = [found for found in units if unit_of(found) is not None]
        bare = not units and unit is None and name == without_brackets(name)
        found = re.fullmatch(r"(.*[^_ ])[_ ]([^_ ]+)", name) if bare else None
        if found is not None and found[2] != "in":
            base, kind = found[1], unit_of(found[2])
            long = len(found[2]) > 1 or (found[2] in "gs" and re.search(r"[^\W\d_]{2}", base))  # a_g, acc_N
            if long and kind is not None and (kind.quantity == "time") == (role_of(base) == "time"):
                name, units = base, [found[2]]
        own = next(iter([*known, *units]), None)
        if unit is not None and own is not None and unit_of(own) != unit_of(unit):
            unit = f"{own} and {unit}"  # which is none that is known
        return cls(text, name or text, unit or own)


def choices(quantity: str) -> str:
    """What `units` may be, as a message lists it."""
    names = ", ".join(f'"{name}"' for name in list(UNITS[quantity])[:7])
    return f"{names}, or a number in {SI.get(quantity, 's')} per file unit"


def unit_factor(units, quantity: str = "acceleration", name: str = "units") -> float:
    """SI units in one file unit of a quantity, in any usual spelling, or the factor itself, positive."""
    if not isinstance(units, str):
        return check_positive(units, name, f"Pass the {SI.get(quantity, 's')} per file unit.")
    if unit := unit_of(units, quantity):
        return unit.factor
    raise ValueError(message(name, f"one of {choices(quantity)}", shown(units)))


def sensitivity_of(sensitivity, quantity: str) -> float:
    """Volts in one SI unit of a quantity, of a number or a text such as "100 mV/g"."""
    if not isinstance(sensitivity, str):
        return check_positive(sensitivity, "sensitivity", f"Pass the V per {SI[quantity]}.")
    if found := _SENSITIVITY.fullmatch(sensitivity):
        number, voltage, unit = float(found[1]), unit_of(found[2], "voltage"), unit_of(found[3], quantity)
        if number > 0.0 and voltage and unit:
            return number * voltage.factor / unit.factor
    what = f'V per {SI[quantity]}, or a text such as "100 mV/{next(iter(UNITS[quantity]))}"'
    raise ValueError(message("sensitivity", what, shown(sensitivity)))


def system_of_units(text: str) -> tuple[float, float, float]:
    """SI units in the force, length and mass of a system of units, "kN, m, t", in any order."""
    words = [word.strip() for word in text.split(",")] if isinstance(text, str) else []
    units = [Unit("mass", MASSES[word]) if word in MASSES else unit_of(word) for word in words]
    found = {unit.quantity: unit.factor for unit in units if unit is not None}
    if set(found) != {"force", "displacement", "mass"} or len(words) != 3:
        what = 'a force, a length and a mass, such as "kN, m, t"'
        raise ValueError(message("units", what, shown(text)))
    return found["force"], found["displacement"], found["mass"]


def resolve_units(channel, request, source: str) -> float:
    """SI units in one unit of a channel, by its file, or by the request where that does not say it."""
    quantity, units, stated = request.quantity, request.units, channel.unit
    said, by = channel.quantity, "data set"
    known, voltage = unit_of(stated), request.sensitivity is not None
    if said is None and stated is None and not voltage and role_of(channel.name) in MEASURED:
        said, by = role_of(channel.name), "label"
    what = f"the {by} {channel.name!r} says {said}. Pass the columns that are, or rename it."
    require(said in (None, quantity), f"{source} must hold {PLURALS[quantity]}, {what}")
    measured = "voltage" if voltage else quantity
    if known is not None and known.quantity != measured:
        volts = f'`sensitivity`, such as "100 mV/({next(iter(UNITS[quantity]))})"'
        advice = volts if known.quantity == "voltage" else f"the columns that are {PLURALS[measured]}"
        beside = "" if units is None else f", beside units={shown(units)}"
        what = f"it states {stated!r}, a unit of {known.quantity}{beside}. Pass {advice}."
        raise ValueError(f"{source} must hold {PLURALS[measured]}, {what}")
    if units is None and known is None:
        said = "does not state them" if stated is None else f"states {stated!r}, which is no known unit"
        raise ValueError(f"`units` must be given, {source} {said}. Pass one of {choices(measured)}.")
    factor = known.factor if units is None else unit_factor(units, measured)
    if known is not None and not np.isclose(factor, known.factor, rtol=0.01, atol=0.0):  # 9.80665 is one g
        what = f"got {shown(units)}. Leave `units` out, or correct the file."
        raise ValueError(f"`units` must be those of the file, {source} states {stated!r}, {what}")
    if known is None and stated is not None:
        warn_caller(f"{source} states the units {stated!r}; the argument units={units!r} is used.")
    return factor / sensitivity_of(request.sensitivity, quantity) if voltage else factor


def resolve_dt(channel, request, source: str) -> float:
    """Sampling interval [s] that the caller says, or else the file."""
    dt, stated = request.dt, channel.dt if (channel.dt or 0.0) > 0.0 else None  # a step of 0 states none
    if dt is None and (stated is None or stated >= 1.0):
        said, more = f"{source} does not state the time step", ""
        if channel.times is not None:
            apart = float(np.diff(channel.times).mean())
            said = f"the times of {source} ({channel.name}) are uneven, {apart:.3g} s apart on average"
            more = " The values are joined by straight lines and read off at this step."
        elif stated is not None:  # a counter or milliseconds, 1000 times too slow
            said = f"{source} states a time step of {stated:g}, too long for seconds"
        raise ValueError(f"`dt` must be given, {said}. {SAMPLING_INTERVAL}{more}")
    if dt is not None and stated is not None and not np.isclose(dt, stated, rtol=1e-3, atol=0.0):
        warn_caller(f"{source} states a time step of {stated:g} s; the argument dt={dt:g} s is used.")
    return stated if dt is None else dt
