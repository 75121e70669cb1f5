"""What the command line says of an update: the verdict, the posterior and the warnings of the report."""

from rich import box
from rich.markup import escape
from rich.table import Table

from pymc_features.update.templates.numbers import COLUMNS, cells, columns_of_words, rows_of, warning_of

# of the posterior, as many as 80 characters hold
SHOWN = ("parameter", "unit", "5 %", "50 %", "95 %", "sd", "learned", "R-hat", "ESS")
TABLES = ("population", "prediction", "modes")  # besides


def summary(document: dict):
    """What to print of a document: sentences, and tables of the first likelihood, each with its style."""
    verdict, rows = document["verdict"], rows_of(document)
    for sentence in verdict["sentences"]:
        yield sentence, "bold" if verdict["explains"] else "bold red"
    for sentence in document["sentences"]:
        yield sentence["text"], None if sentence["is_good"] else "bold red"
    first, places = rows[0].kind, [COLUMNS.index(name) for name in SHOWN]
    posterior = [[row[k] for k in places] for row in cells([row for row in rows if row.kind == first])]
    title = f"Posterior under {first}"
    yield drawn_table({"title": title, "columns": SHOWN, "rows": posterior}, no_wrap=True), None
    tables = {one["name"]: one for one in document["tables"]}
    for one in (tables[name] for name in TABLES if name in tables):
        if one["columns"][0] == "likelihood":
            rows = [row[1:] for row in one["rows"] if row[0] == first]
            one |= {"columns": one["columns"][1:], "rows": rows, "title": f"{one['title']} under {first}"}
        yield drawn_table(one), None
    yield document["changed"], None
    for one in document["findings"]:
        yield f"warning: {warning_of(one)}", "yellow"


def drawn_table(asked: dict, no_wrap=False) -> Table:
    """A table of the report for the terminal: columns of words to the left, of numbers to the right."""
    compact = {"collapse_padding": True, "pad_edge": False}
    drawn = Table(title=asked["title"], title_justify="left", box=box.SIMPLE_HEAD, **compact)
    for name, is_text in zip(asked["columns"], columns_of_words(asked), strict=True):
        drawn.add_column(escape(name), justify="left" if is_text else "right", no_wrap=no_wrap)
    for row in asked["rows"]:
        drawn.add_row(*map(escape, row))
    return drawn
