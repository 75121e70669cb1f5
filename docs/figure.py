"""The figure of intervals.md: `python docs/figure.py` writes docs/figure.svg.

Exact posteriors of the stiffness factor, by quadrature, of one history read at seven sampling steps. The
record is El Centro 1940; the test draws it from a short synthetic one.
"""

from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from pymc_features import datasets, paper
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.study.exact import STATISTICS, reference
from pymc_features.study.settings import Study

LABELS = {
    "NORM": "NORM: every sample independent",
    "TN": "TN: half-normal law of the misfit",
    "EXP": "EXP: exponential law of the misfit",
    "ABC": "ABC: likelihood-free, at Eq. (16)",
}
# letters as paths, and no date: the same file on every machine
STYLE = {"font.size": 10.5, "svg.fonttype": "path", "svg.hashsalt": "pymc_features"}


def intervals(record, multipliers=paper.MULTIPLIERS):
    """Steps [s] (m,), and for each likelihood the exact 5, 50 and 95 % quantiles of theta (m, 3)."""
    study = Study(record, likelihoods=list(LABELS), multipliers=multipliers)
    columns = [STATISTICS.index(name) for name in ("q05", "q50", "q95")]
    return study.step(np.array(study.multipliers)), {
        kind: np.array([reference(kind, study.misfit(m)).statistics[0, columns] for m in study.multipliers])
        for kind in LABELS
    }


def draw(steps, quantiles):
    """Intervals on the left, their widths on the right, against the step in milliseconds."""
    steps = 1e3 * steps
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 4.0), layout="constrained")
    left.axhline(1.0, color="0.35", lw=0.9, ls="--", zorder=0, label="true value")
    for i, (kind, (low, middle, high)) in enumerate((k, q.T) for k, q in quantiles.items()):
        beside = steps * 1.15 ** (i - 1.5)
        errors = [middle - low, high - middle]
        left.errorbar(beside, middle, errors, fmt="o", ms=3.5, lw=2.2, color=LIKELIHOODS[kind].colour)
        right.plot(steps, high - low, "o-", lw=1.8, ms=4, color=LIKELIHOODS[kind].colour, label=LABELS[kind])
    left.set(ylabel="stiffness factor θ [-]", title="5-95 % interval")
    left.ticklabel_format(axis="y", useOffset=False)
    left.legend(loc="upper left", bbox_to_anchor=(0.0, 1.02), frameon=False, fontsize="small")
    left.margins(y=0.12)
    right.set(yscale="log", ylabel="width in θ [-]", title="width of the interval")
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_xticks(steps, [f"{s:g}" for s in steps])
        ax.minorticks_off()
        ax.set_xlabel("sampling step of the same signal [ms]")
        ax.spines[["top", "right"]].set_visible(False)
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def write(path, record, **options):
    """Draw the figure of a record and write it."""
    with matplotlib.rc_context(STYLE):
        figure = draw(*intervals(record, **options))
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    write(Path(__file__).with_name("figure.svg"), datasets.el_centro())
