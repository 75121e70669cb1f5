"""A commented configuration that runs as it is."""

from pathlib import Path

import numpy as np

from pymc_features import datasets
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.simulators import simulate
from pymc_features.storage import write_atomically
from pymc_features.structures import ModalDamping, SpringMassChain

TABLE = """\
dataset = "mini_shake_table"     # measured by others; or your own:
event = "northridge"
# files = {{ base = "ground.csv", floor1 = "first.csv", floor2 = "second.csv" }}
# columns = "Acc_X"              # in every file, by header name or index from 0
# units = "m/s^2"                # g, m/s^2, cm/s^2, gal, or m/s^2 per file unit
# skip = 1                       # rows to leave out at the start of each file\
"""
SYNTHETIC_DATA = """\
files = "{file}"   # simulated, with noise: k = 385, 420, 600 N/m, damping 1 %
# files = {{ base = "ground.csv", floor1 = "first.csv", floor2 = "second.csv" }}
# columns = "Acc_X"              # in every file, by header name or index from 0
# units = "m/s^2"                # g, m/s^2, cm/s^2, gal; needed where the header does not say
# skip = 1                       # rows to leave out at the start of each file\
"""
TABLE_PROCESSING = """\
detrend = {{ window = [0.5, 9.5] }}   # offset, from the quiet time before the shaking [s]
check_band = [0.5, 1.8]             # Hz, below half of the first natural frequency: gains, lags, signs
band_pass = {{ high = 25.0 }}         # corner frequencies low and high [Hz]; without low a low-pass
trim = [9.0, 24.0]                  # s; the structure is at rest at the start\
"""
SYNTHETIC_PROCESSING = """\
band_pass = {{ high = 25.0 }}         # corner frequencies low and high [Hz]; without low a low-pass
# detrend = {{ window = [0.0, 0.5] }} # offset, from a quiet time before the shaking [s]
# check_band = [0.5, 1.8]           # Hz, below half of the first natural frequency: gains, lags, signs
# trim = [0.0, 10.0]                # s; the structure is at rest at the start\
"""
TEMPLATE = """\
# A configuration of `pymc-features update`. Files are relative to this one.

[data]
{data}
base = "base"                       # the sensor that measured the motion of the base
sensors = ["floor1", "floor2", "floor3"]
# dofs = [0, 1, 2]                  # where they are, 0 next to the base; needed if some have no sensor

# [record]                          # the motion of the base, where no sensor measured it
# path = "motion.at2"

[processing]                        # in this order, base and sensors alike
{processing}
# decimate = 2                      # every second sample of the sensors, after a low-pass

[structure]
type = "SpringMassChain"            # or HystereticChain, DuffingChain, LinearStructure, AffineStructure
mass = [0.1601, 0.1601, 0.1421]     # kg, from the base up
stiffness = ["k1", "k2", "k3"]      # N/m: numbers, names of priors, or {{ prior = "theta", times = 400.0 }}
damping = {{ type = "ModalDamping", ratios = "zeta" }}   # or RayleighDamping with alpha and beta

[priors]                            # continuous distributions of PyMC, by name, with their arguments
k1 = {{ distribution = "LogNormal", mu = 6.0, sigma = 0.2 }}      # median exp(6) = 403 N/m, 20 %
k2 = {{ distribution = "LogNormal", mu = 6.2, sigma = 0.2 }}
k3 = {{ distribution = "LogNormal", mu = 6.3, sigma = 0.2 }}
zeta = {{ distribution = "LogNormal", mu = -4.6, sigma = 0.4 }}   # median 1 %
sigma = {{ distribution = "HalfNormal", sigma = {scale} }}          # m/s^2, scale of the misfit

[likelihood]
kinds = ["NORM", "TN", "EXP", "ABC"]   # NORM takes every sample for a new observation
sigma = "sigma"                     # one for all sensors, or a list with one for each
# epsilon = 5.0                     # of ABC [m^2/s^4]; without it from EXP, Eq. (16)

[sampler]
method = "smc"                      # or nuts, laplace; ABC by subset simulation always
draws = 1000                        # of each chain
chains = 2
random_seed = 0
# cores = 2                         # processes; all processors by default

[report]
title = "{title}"
{report}
quantities = ["inter_storey_drift", "base_shear"]   # largest values, predicted
"""
TABLE_REPORT = "natural_frequencies = [3.7, 11.2, 16.7]   # Hz, identified by others, to compare with"
SYNTHETIC_REPORT = "natural_frequencies = [{frequencies}]   # Hz, true ones, to compare with"


def write_example(path, *, synthetic: bool = False) -> tuple[list[Path], str]:
    """Write a configuration that runs, with the shaking table's data or with simulated ones.

    Parameters
    ----------
    path : path
        Where; nothing there is overwritten.
    synthetic : bool
        Do not look for the shaking table's data.

    Returns
    -------
    list of Path, str
        Files written, and a sentence that says which data they use and why.

    Raises
    ------
    FileExistsError, FileNotFoundError
        If a file is in the way, or the folder is missing.
    """
    path = Path(path)
    measured = path.with_name(f"{path.stem}-measured.csv")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"`CONFIG` must be in an existing folder, got {path.parent}.")
    reason = "as asked"
    if not synthetic:
        try:
            datasets.mini_shake_table("northridge")
        except DatasetUnavailableError:
            synthetic, reason = True, "since the shaking table's could not be had here"
    for file in (path, measured) if synthetic else (path,):
        if file.exists():
            raise FileExistsError(f"`CONFIG` must be a new file, got {file}. Choose another name.")
    if not synthetic:
        write(path, TABLE, TABLE_PROCESSING, TABLE_REPORT, "Shaking table, three storeys", scale="2.0")
        return [path], "data: measured, a three-storey model on a shaking table (northridge)"
    text, frequencies = simulated()
    write_atomically(measured, lambda p: p.write_text(text, encoding="utf-8"))
    listed = ", ".join(f"{f:.3f}" for f in frequencies)
    parts = SYNTHETIC_DATA, SYNTHETIC_PROCESSING, SYNTHETIC_REPORT, "Simulated, three storeys"
    write(path, *parts, scale="0.5", file=measured.name, frequencies=listed)
    return [path, measured], f"data: simulated, in {measured.name}, {reason}"


def write(path, data, processing, report, title, **values):
    """Fill the template."""
    parts = {"data": data, "processing": processing, "report": report}
    filled = {name: part.format(**values) for name, part in parts.items()}
    text = TEMPLATE.format(**filled, title=title, scale=values["scale"])
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def simulated() -> tuple[str, np.ndarray]:
    """Text of a file with the simulated channels, and the natural frequencies [Hz] behind them."""
    record = synthetic_earthquake(12.0, 0.01, random_seed=7, pga=3.0)
    chain = SpringMassChain([0.1601, 0.1601, 0.1421], [385.0, 420.0, 600.0], ModalDamping(0.01))
    floors = simulate(chain, record).values
    exact = np.vstack([record.acceleration, floors])
    # noise of the sensor, and on the floors an error of the model in its place
    scale = np.array([0.01, *(0.05 * floors.std(axis=1))])[:, None]
    values = exact + scale * np.random.default_rng(7).standard_normal(exact.shape)
    names = ["time [s]", "base [m/s^2]", *(f"floor{i} [m/s^2]" for i in (1, 2, 3))]
    lines = [",".join(names)]
    lines += [
        f"{t:.2f}," + ",".join(f"{v:.5f}" for v in row) for t, row in zip(record.time, values.T, strict=True)
    ]
    return "\n".join(lines) + "\n", chain.modes().natural_frequencies
