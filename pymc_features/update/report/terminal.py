"""What the command line says of an update: the verdict, the posterior and the warnings of the report."""

from rich import box
from rich.markup import escape
from rich.table import Table

from pymc_features.update.kinds.modal import COLUMNS as MODE_COLUMNS
from pymc_features.update.plausibility.findings import mode_rows
from pymc_features.update.report.document import gain_rows
from pymc_features.update.report.findings import Findings
from pymc_features.update.report.numbers import COLUMNS, PREDICTED, cells, predicted_cells

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
    if found.predicted:
        yield predicted_table(found.predicted), None
    if found.modes:
        yield modes_table(found.modes[first], f"Identified modes [Hz] under {first}"), None
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


def predicted_table(rows) -> Table:
    """The largest responses to other motions, and the probabilities of limits."""
    drawn = plain_table("Other motions")
    for name in PREDICTED:
        drawn.add_column(name, justify="left" if name in PREDICTED[:3] else "right")
    for row in predicted_cells(rows):
        drawn.add_row(*map(escape, row))
    return drawn


def modes_table(rows, title) -> Table:
    """Identified modes beside those of the model."""
    drawn = plain_table(title)
    for name in MODE_COLUMNS:
        drawn.add_column(name, justify="left" if name == "mode" else "right", no_wrap=True)
    for row in rows:
        drawn.add_row(*map(escape, row.cells))
    return drawn


def gains_table(gains) -> Table:
    """Gain, lag and coherence of each sensor against the base."""
    drawn = plain_table("Against the base")
    for name in ("sensor", "gain [-]", "lag [ms]", "coherence [-]"):
        drawn.add_column(escape(name), justify="left" if name == "sensor" else "right", no_wrap=True)
    for row in gain_rows(gains):
        drawn.add_row(*map(str, row))
    return drawn


def priors_table(compared) -> Table:
    """Natural frequencies and damping that the priors expect beside those of the data."""
    drawn = plain_table("Priors (5 to 95 %) and data")
    for name in ("mode", "priors [Hz]", "data [Hz]", "priors [%]", "damping of data [%]", "seen by"):
        drawn.add_column(escape(name), justify="left" if name in ("mode", "seen by") else "right")
    for row in mode_rows(compared):
        drawn.add_row(*map(escape, row))
    return drawn


def plain_table(title) -> Table:
    """An empty table that fits into 80 characters."""
    compact = {"collapse_padding": True, "pad_edge": False}
    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, **compact)
