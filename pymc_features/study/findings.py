"""What the study says, in tables of a few numbers and in words."""

import numpy as np
import xarray as xr

from pymc_features.likelihoods import LIKELIHOODS

# a fine step shortens an interval, or lengthens it, by this exponent of the step where it matters at all
NO_TREND = 0.05


def intervals(result: xr.DataTree, kind: str, values: str = "exact") -> xr.DataArray:
    """Ends of the 5-95 % interval of theta (multiplier, statistic)."""
    summary = result["summary"].to_dataset()
    return summary[values].sel(likelihood=kind, parameter="theta", statistic=["q05", "q95"])


def widths(result: xr.DataTree, kind: str, values: str = "exact") -> np.ndarray:
    """5-95 % width of theta at each sampling step (multiplier,)."""
    return np.diff(intervals(result, kind, values).values, axis=1)[:, 0]


def verdict(kind: str, steps, width) -> str:
    """What a finer sampling does to an interval, from its widths at the two smallest steps."""
    if len(steps) < 2:
        return "one sampling step only"
    exponent = np.log(width[1] / width[0]) / np.log(steps[1] / steps[0])
    if abs(exponent) <= NO_TREND:
        return f"settles: {abs(width[0] / width[1] - 1.0):.2%} between the two smallest steps"
    trend = "narrows" if exponent > 0 else "widens"
    reason = LIKELIHOODS[kind].reasons.get(trend)
    return f"{trend} as the step shrinks, like its power {exponent:.2g}" + (f": {reason}" if reason else "")


def trend_rows(result: xr.DataTree) -> list[list]:
    """For each likelihood its meaning, exact widths of theta, and what they say about the sampling rate."""
    summary = result["summary"].to_dataset()
    steps = summary["multiplier"].values
    rows = []
    for kind in map(str, summary["likelihood"].values):
        width = widths(result, kind)
        rows.append([kind, LIKELIHOODS[kind].meaning, *map(float, width), verdict(kind, steps, width)])
    return rows


def agreement_rows(result: xr.DataTree) -> list[list]:
    """ABC beside EXP and TN at each sampling step; empty without ABC.

    Tolerance, ends of the exact set {theta: rho <= delta}, the smallest and largest draw, the 5-95 %
    intervals of ABC, sampled and exact, and the exact widths of EXP and TN over that of ABC.
    """
    summary = result["summary"].to_dataset()
    kinds = list(map(str, summary["likelihood"].values))
    if "ABC" not in kinds:
        return []
    sampled, exact = (intervals(result, "ABC", values).values for values in ("sampled", "exact"))
    abc = widths(result, "ABC")
    beside = [widths(result, kind) / abc if kind in kinds else abc * np.nan for kind in ("EXP", "TN")]
    rows = []
    for j, multiplier in enumerate(summary["multiplier"].values):
        draws = result[f"ABC/x{multiplier:g}/posterior"]["theta"].values
        epsilon, ends = summary["epsilon"][j], summary["epsilon_interval"].values[j]
        numbers = multiplier, epsilon, *ends, draws.min(), draws.max(), *sampled[j], *exact[j]
        rows.append([*map(float, numbers), *(float(ratio[j]) for ratio in beside)])
    return rows


def yielding(result: xr.DataTree) -> str:
    """How far the springs yield, in words; empty if they cannot."""
    if "loops" not in result.children:
        return ""
    ductility = result["loops"]["ductility"].values
    n, most = int((ductility > 1.0).sum()), int(ductility.argmax())
    if n == 0:
        return (
            f"no spring reaches its yield displacement (at most {ductility[most]:.2g} of it, spring {most}): "
            "this says little about structures that yield"
        )
    return (
        f"{n} of {len(ductility)} springs drift beyond their yield displacement, "
        f"at most {ductility[most]:.2g} times as far (spring {most})"
    )


def ductility_rows(result: xr.DataTree) -> list[list]:
    """Number, yield displacement [m], largest drift [m] and their ratio of each spring that can yield."""
    if "loops" not in result.children:
        return []
    loops = result["loops"].to_dataset()
    peaks = abs(loops["drift"]).max("time")
    columns = (loops["spring"], loops["yield_displacement"], peaks, loops["ductility"])
    return [[int(i), *map(float, row)] for i, *row in zip(*(c.values for c in columns), strict=True)]


DUCTILITY_COLUMNS = ("spring", "yield displacement [m]", "largest drift [m]", "ductility")
AGREEMENT_COLUMNS = (
    "step / record step",
    "delta",
    "set from",
    "set to",
    "smallest draw",
    "largest draw",
    "5 %",
    "95 %",
    "exact 5 %",
    "exact 95 %",
    "width EXP / ABC",
    "width TN / ABC",
)
