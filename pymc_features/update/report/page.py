"""One page that moves, from a saved result alone: a single HTML file without other files or a network.

Its words and tables are those of the attribute `document`, see `report.document`; its scripts draw what
`report.payload` finds in the groups. plotly's own script is embedded once.
"""

import json
from importlib.resources import files
from pathlib import Path

import xarray as xr

from pymc_features.storage import write_atomically
from pymc_features.update.report.payload import payload_of
from pymc_features.update.templates import TEMPLATES, numbers


def write_page(source, out=None) -> Path:
    """Make the page of a saved `update.nc` again, beside it by default; its path."""
    source = Path(source)
    if not source.is_file():
        raise ValueError(f"`RESULT` must be an existing file, got {source}. Name the update.nc of an update.")
    result = read_result(source, "RESULT")
    out = Path(out or source.with_name("report.html"))
    write_atomically(out, lambda path: path.write_text(page_of(result), encoding="utf-8"))
    return out


def read_result(path: Path, argument: str) -> xr.DataTree:
    """A saved result with the words of its report; messages call its path by the argument of a command."""
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            result = tree.load()
    except (OSError, ValueError) as error:
        raise ValueError(f"`{argument}` must be the update.nc of an update, got {path}: {error}") from error
    if "document" not in result.attrs:
        raise ValueError(
            f"`{argument}` must hold the words of its report, {path} has none. Run `pymc-features update` "
            "again: finished likelihoods are kept."
        )
    return result


def page_of(result) -> str:
    document, payload = json.loads(result.attrs["document"]), payload_of(result)
    rows, tables = numbers.rows_of(document), {}
    for one in document["tables"]:
        tables.setdefault(one["section"], []).append(one | {"texts": numbers.columns_of_words(one)})
    shown = [numbers.COLUMNS, *numbers.cells(rows)]
    texts = [k < numbers.N_TEXTS for k in range(len(numbers.COLUMNS))]
    posterior = {"columns": shown[0], "rows": shown[1:], "texts": texts}
    downloads = numbers.files_of(rows) | {"table-as-shown.csv": "\n".join(map(",".join, shown))}
    plotly = files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    shown = {"document": document, "tables": tables, "posterior": posterior, "payload": payload}
    shown |= {"data": in_script(payload), "downloads": in_script(downloads), "plotly": plotly}
    return TEMPLATES.get_template("report.html").render(shown)


def in_script(value) -> str:
    """JSON that cannot end the script it stands in."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
