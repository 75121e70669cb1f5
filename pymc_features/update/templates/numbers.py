"""Numbers as people read them: digits from the standard deviation, engineering prefixes with the unit.

One function, `cells`, for the terminal, the page and LaTeX; `as_csv` alone keeps full precision in SI units.
"""

import math
import re
from typing import NamedTuple

COLUMNS = ("likelihood", "parameter", "unit", "5 %", "50 %", "95 %", "mean", "sd", "learned", "R-hat", "ESS")
N_TEXTS = 3  # columns of words in front
NUMBER = re.compile(r"\s*(nan|[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?) *%?")
DIGITS = 2  # significant digits of a standard deviation that are shown
MOST_DECIMALS = 15
# prefixes that people use with each unit: powers of ten, and what the unit is called then
FORCES = {-3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
PREFIXES = {
    **dict.fromkeys(("N", "N/m", "N s/m", "N m", "N m/rad", "J", "Pa", "W"), FORCES),
    **dict.fromkeys(("m", "s"), {-6: "µ", -3: "m", 0: ""}),
    **dict.fromkeys(("m/s", "m/s^2"), {-3: "m", 0: ""}),
    "Hz": {0: "", 3: "k"},
    "kg": {-3: "g", 0: "kg", 3: "t", 6: "kt"},  # names of their own
    "rad": {-3: "m", 0: ""},
}
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LOWERED = {raised: chr(plain) for plain, raised in RAISED.items()}
SPECIAL = {letter: f"\\{letter}" for letter in "_%&#$"} | {"µ": "$\\mu$"}
# the smallest value that is shown without a prefix: by default 1, and 0.001 of units that have none
PLAIN_FROM = {"m": 0.1, "s": 0.1, "Hz": 0.0, "m/s^2": 1e-3, "m/s": 1e-3, "rad": 1e-3}
PLAIN_BELOW = {"-": 1e4}  # by default 1000


class Row(NamedTuple):
    """One parameter under one likelihood."""

    kind: str  # likelihood, parameter, and its SI unit
    name: str
    unit: str
    q05: float  # median between the ends of the 90 % interval, mean and standard deviation, in SI units
    q50: float
    q95: float
    mean: float
    sd: float
    # share of the prior's variance that the data took away [-]; 0 where the posterior is as wide or wider
    taught: float
    r_hat: float  # of the chains, and the effective number of draws; NaN where they are not told
    ess: float
    overlap: float  # mass that prior and posterior share [-]


def rows_of(document: dict) -> list[Row]:
    """The posterior of a saved document."""
    saved = (row.values() for row in document["posterior"])
    return [Row(*(math.nan if value is None else value for value in values)) for values in saved]


class Scale(NamedTuple):
    """A unit with a prefix: what is shown is the value over `factor`."""

    factor: float
    unit: str


def scale_of(size: float, unit: str) -> Scale:
    """The prefix for values of a size, or a power of ten in front of a unit that has none."""
    size, known = abs(size), PREFIXES.get(unit)
    plain_from = PLAIN_FROM.get(unit, 1e-3 if known is None else 1.0)
    if not math.isfinite(size) or size == 0.0 or plain_from <= size < PLAIN_BELOW.get(unit, 1e3):
        return Scale(1.0, pretty(unit))
    power = 3 * math.floor(math.log10(size) / 3.0 + 1e-12)
    if known is None:
        ten = f"10{str(power).translate(RAISED)}"
        return Scale(10.0**power, ten if unit == "-" else f"{ten} {pretty(unit)}")
    power = min(max(power, min(known)), max(known))
    return Scale(10.0**power, known[power] if unit == "kg" else f"{known[power]}{pretty(unit)}")


def pretty(unit: str) -> str:
    """A unit with raised exponents."""
    return unit.replace("^2", "²").replace("^3", "³")


def fixed(values, sd: float, scale: Scale) -> list[str]:
    """Values under one scale, with two significant digits of their standard deviation.

    Without one with four significant digits of the largest; what differs is shown to differ.
    """
    values, sd = [value / scale.factor for value in values], sd / scale.factor
    known = [value for value in values if math.isfinite(value)]
    if sd > 0.0 and math.isfinite(sd):
        decimals = DIGITS - 1 - math.floor(math.log10(float(f"{sd:.1e}")))
    else:
        largest = max(map(abs, known), default=0.0)
        decimals = 3 - math.floor(math.log10(largest)) if largest > 0.0 else 0
    decimals = min(max(decimals, 0), MOST_DECIMALS)
    while decimals < MOST_DECIMALS and len({f"{v:.{decimals}f}" for v in known}) < len(set(known)):
        decimals += 1
    return [f"{value:.{decimals}f}" if math.isfinite(value) else "" for value in values]


def interval_texts(quantiles, unit: str) -> tuple[str, list[str]]:
    """Unit with its prefix, and 5, 50 and 95 % of something whose standard deviation is told by them."""
    low, _, high = quantiles
    scale = scale_of(max(map(abs, quantiles)), unit)
    return scale.unit, fixed(quantiles, (high - low) / 3.29, scale)


def scales_of(table: list[Row]) -> dict[str, Scale]:
    """The prefix of each parameter, one under all likelihoods."""
    return {r.name: scale_of(max(map(abs, (r.q05, r.q50, r.q95))), r.unit) for r in reversed(table)}


def cells(table: list[Row]) -> list[tuple[str, ...]]:
    """Texts of the rows, in the order of `COLUMNS`."""
    scales, found = scales_of(table), []
    for row in table:
        scale = scales[row.name]
        places = fixed([row.q05, row.q50, row.q95], row.sd, scale)
        mean = f"{row.mean / scale.factor:.{len(places[1].partition('.')[2])}f}"
        [sd] = fixed([row.sd], row.sd, scale)
        told = [
            form.format(value) if math.isfinite(value) else ""
            for form, value in (("{:.2f}", row.taught), ("{:.3f}", row.r_hat), ("{:.0f}", row.ess))
        ]
        found.append((row.kind, row.name, scale.unit, *places, mean, sd, *told))
    return found


def as_csv(table: list[Row]) -> str:
    """The table in full precision and SI units, for programs."""
    shown = [COLUMNS, *(row[: len(COLUMNS)] for row in table)]
    lines = [",".join(v if isinstance(v, str) else f"{v:.10g}" for v in row) for row in shown]
    return "\n".join(lines) + "\n"


def as_latex(table: list[Row]) -> str:
    """The table as people read it, a `tabular` that needs no package."""
    header = [escaped(name) for name in COLUMNS]
    lines = [f"\\begin{{tabular}}{{{'l' * N_TEXTS}{'r' * (len(COLUMNS) - N_TEXTS)}}}", "\\hline"]
    rows = [header, *([escaped(cell) for cell in row] for row in cells(table))]
    lines += [f"{' & '.join(row)} \\\\{' \\hline' if row is header else ''}" for row in rows]
    return "\n".join([*lines, "\\hline", "\\end{tabular}"]) + "\n"


def files_of(table: list[Row]) -> dict[str, str]:
    """Names of files to the table in them."""
    return {"table.csv": as_csv(table), "table.tex": as_latex(table)}


def escaped(text: str) -> str:
    """A text in LaTeX; raised digits are exponents."""
    text = "".join(SPECIAL.get(letter, letter) for letter in text)
    raised = f"[{''.join(map(chr, LOWERED))}]+"
    return re.sub(raised, lambda found: f"$^{{{found[0].translate(LOWERED)}}}$", text)


def predicted_quantities(result):
    """Title, Dataset and quantity of every prediction in a result."""
    for title, node in getattr(result.children.get("predict"), "children", {}).items():
        data = node.to_dataset()
        for name in data.data_vars:
            if str(name).endswith("_peak"):
                yield title, data, str(name).removesuffix("_peak")


def warning_of(finding: dict) -> str:
    """A finding as a sentence that begins with its likelihood."""
    return f"{finding['kind']}: {finding['text'][:1].upper()}{finding['text'][1:]}"


def columns_of_words(table: dict) -> list[bool]:
    """Which columns of a table have words, and no number, perhaps with a sign of per cent."""
    return [not any(NUMBER.fullmatch(row[k]) for row in table["rows"]) for k in range(len(table["columns"]))]
