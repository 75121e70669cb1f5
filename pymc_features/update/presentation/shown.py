"""Verdicts, tables as plain structures, and figures that are drawn when they are written."""

import io
from typing import NamedTuple

import numpy as np

from pymc_features import plots
from pymc_features.storage import write_atomically

CHECK_DPI, REPORT_DPI = 120, 110
SENSORS = ("sensor", "degree of freedom", "peak [m/s²]", "rms [m/s²]")


class Verdict(NamedTuple):
    """What to think of the fit.

    Attributes
    ----------
    sentences : list of str
        The first says whether the model explains the measurements; others say why not.
    explains : bool
        Whether it does.
    """

    sentences: list[str]
    explains: bool


class Figure(NamedTuple):
    """A figure: its file name without suffix, its caption, and a function that draws it."""

    name: str
    caption: str
    draw: object

    def png(self) -> bytes:
        """The figure as a PNG file; it is released."""
        axes, buffer = self.draw(), io.BytesIO()
        axes[0].figure.savefig(buffer, dpi=REPORT_DPI, format="png")
        plots.close(axes[:1])
        return buffer.getvalue()


def table(name, section, title="", columns=(), rows=(), note="") -> dict:
    """A table of the report; its cells become texts."""
    rows = [[str(cell) for cell in row] for row in rows]
    named = {"name": name, "section": section, "title": title}
    return named | {"columns": list(columns), "rows": rows, "note": note}


def write_figure(axes, path) -> None:
    """A figure as a PNG file; it is released."""
    figure = axes[0].get_figure(root=True)
    write_atomically(path, lambda to: figure.savefig(to, dpi=CHECK_DPI, format="png"))
    plots.close(axes[:1])


def sensor_rows(names, dofs, histories) -> list[tuple]:
    """Largest value and root mean square of each history, as of `SENSORS`."""
    return [
        (name, dof, f"{np.nanmax(np.abs(values)):.4g}", f"{np.sqrt(np.nanmean(values**2)):.4g}")
        for name, dof, values in zip(names, dofs, histories, strict=True)
    ]


def processing_steps(source, asked) -> list[str]:
    """Say where channels come from, and what [processing] did to them."""
    steps = [f"source is {source}"]
    if asked.detrend is not None:
        window = asked.detrend.window
        over = f" of {window[0]:g} to {window[1]:g} s" if window else ""
        steps.append(f"less the {asked.detrend.kind} trend{over}")
    if asked.band_pass is not None:
        sides = ("above", asked.band_pass.low), ("below", asked.band_pass.high)
        corners = [f"{side} {corner:g} Hz" for side, corner in sides if corner is not None]
        steps.append(f"filtered to {' and '.join(corners)}")
    if asked.trim is not None:
        steps.append(f"window {asked.trim[0]:g} to {asked.trim[1]:g} s")
    return steps
