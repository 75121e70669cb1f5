"""What an update leaves behind: netCDF, table, figures and report."""

import io
from pathlib import Path

from pymc_features import plots
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.problem import Problem
from pymc_features.update.report.figures import figures
from pymc_features.update.report.findings import Findings, findings
from pymc_features.update.report.page import report
from pymc_features.update.report.summary import as_csv

DPI = 110


def write_outputs(
    problem: Problem, result, folder, channel_warnings=(), found: Findings | None = None
) -> list[Path]:
    """Write `update.nc`, `table.csv`, the figures and `report.html`; return their paths.

    Parameters
    ----------
    problem : Problem
        What was updated.
    result : DataTree
        From `run_update`.
    folder : path
        Made if needed.
    channel_warnings : sequence of str
        What was said about the channels, and identified modes, when they were read.
    found : Findings, optional
        From `findings`, if it is at hand; else it is made here.

    Returns
    -------
    list of Path
        The report last.
    """
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    found = found or findings(problem, result)
    doubts = [*(f"data: {text}" for text in channel_warnings), *found.doubts]
    drawn = [(figure, png(figure.draw())) for figure in figures(problem, result, found.modes)]
    writers = {
        "update.nc": lambda path: path.write_bytes(netcdf_bytes(result)),
        "table.csv": lambda path: path.write_text(as_csv(found.table), encoding="utf-8"),
    }
    for figure, image in drawn:
        writers[f"figures/{figure.name}.png"] = lambda path, image=image: path.write_bytes(image)
    html = report(problem, result, found._replace(doubts=doubts), drawn)
    writers["report.html"] = lambda path: path.write_text(html, encoding="utf-8")
    for name, write in writers.items():
        write_atomically(folder / name, write)
    return [folder / name for name in writers]


def png(axes) -> bytes:
    """A figure as a PNG file; it is released."""
    buffer = io.BytesIO()
    axes[0].figure.savefig(buffer, dpi=DPI, format="png")
    plots.close(axes[:1])
    return buffer.getvalue()
