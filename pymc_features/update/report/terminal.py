"""What the command line says of an update: the verdict, the posterior and the warnings of the report."""

from rich import box
from rich.markup import escape
from rich.table import Table

from pymc_features.update.presentation.mode_rows import COLUMNS as MODES
from pymc_features.update.presentation.numbers import COLUMNS, cells, is_number
from pymc_features.update.presentation.shown import table
from pymc_features.update.report.document import table_of_population, table_of_predictions
from pymc_features.update.report.findings import Findings

# as many as 80 characters hold
SHOWN = (
    "parameter",
    "unit",
    "5 %",
    "50 %",
    "95 %",
    "sd",
    "learned",
    "R-hat",
    "ESS",
)


def summary(found: Findings):
    """What to print, in order: sentences with their style, and a table.

    Parameters
    ----------
    found : Findings
        From `findings`.

    Yields
    ------
    str or rich.table.Table, str or None
        A sentence or the posterior under the first likelihood, and a style.
    """
    for sentence in found.verdict.sentences:
        yield sentence, "bold" if found.verdict.explains else "bold red"
    if found.events:
        yield found.events, None if found.is_unchanged else "bold red"
    if found.left_out:
        yield found.left_out, None
    if found.supported:
        yield found.supported, None
    first = found.table[0].kind
    yield posterior_table([row for row in found.table if row.kind == first]), None
    for sentence in found.besides:
        yield sentence, None
    if found.population:
        yield drawn_table(table_of_population([row for row in found.population if row[0] == first])), None
    if found.predicted:
        yield drawn_table(table_of_predictions(found.predicted)), None
    if found.modes:
        modes = [row.cells for row in found.modes[first]]
        title = f"Identified modes [Hz] under {first}"
        yield drawn_table(table("modes", "modes", title, MODES, modes)), None
        yield found.changed, None
    for sentence in found.doubts:
        yield f"warning: {sentence}", "yellow"


def posterior_table(table) -> Table:
    """The posterior under one likelihood."""
    drawn = plain_table(f"Posterior under {table[0].kind}")
    for name in SHOWN:
        drawn.add_column(name, justify="left" if name in ("parameter", "unit") else "right", no_wrap=True)
    for row in cells(table):
        drawn.add_row(*(row[COLUMNS.index(name)] for name in SHOWN))
    return drawn


def drawn_table(asked: dict) -> Table:
    """A table of the report for the terminal: columns of words to the left, of numbers to the right."""
    drawn = plain_table(asked["title"])
    for k, name in enumerate(asked["columns"]):
        is_text = all(not is_number(row[k]) for row in asked["rows"])
        drawn.add_column(escape(name), justify="left" if is_text else "right")
    for row in asked["rows"]:
        drawn.add_row(*map(escape, row))
    return drawn


def plain_table(title) -> Table:
    """An empty table that fits into 80 characters."""
    compact = {"collapse_padding": True, "pad_edge": False}
    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, **compact)
