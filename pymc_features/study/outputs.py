"""What the study leaves behind: figures, tables and netCDF."""

from pathlib import Path

from pymc_features import plots
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.study.table import as_csv, as_markdown

BOTH = ["theta", "sigma"]
FIGURES = {  # likelihoods and parameters; those with all their likelihoods in the study are drawn
    "fig2_theta.png": (["TN", "NORM"], ["theta"]),
    "fig3_sigma.png": (["TN", "NORM"], ["sigma"]),
    "fig4_exp_norm_abc.png": (["EXP", "NORM", "ABC"], BOTH),
    "fig5_correlated.png": (["NORM", "CN", "CN-SIGMA", "CN-TAU"], BOTH),
}


def write_outputs(result, folder: Path) -> list[Path]:
    """Write figures, tables and the result into `folder`; return their paths."""

    def save(axes):
        return lambda path: axes[0].figure.savefig(path, dpi=150, format="png")

    figures = {"fig1_record.png": plots.plot_record(result)}
    known = set(result["summary"]["likelihood"].values)
    for name, (likelihoods, parameters) in FIGURES.items():
        if known.issuperset(likelihoods):
            figures[name] = plots.plot_sampling_rate(result, likelihoods, parameters=parameters)
    figures["fig6_widths.png"] = plots.plot_widths(result)
    if "loops" in result.children:
        figures["fig7_loops.png"] = plots.plot_loops(result)
    writers = {name: save(axes) for name, axes in figures.items()}
    writers["table.md"] = lambda path: path.write_text(as_markdown(result))
    writers["table.csv"] = lambda path: path.write_text(as_csv(result))
    writers["study.nc"] = lambda path: path.write_bytes(netcdf_bytes(result))
    for name, write in writers.items():
        write_atomically(folder / name, write)
    plots.close(axes[0] for axes in figures.values())
    return [folder / name for name in writers]
