"""A commented configuration that runs as it is."""

from pathlib import Path

import numpy as np

from pymc_features import datasets
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.simulators import simulate
from pymc_features.storage import write_atomically
from pymc_features.structures import ModalDamping, SpringMassChain
from pymc_features.update.templates import TEMPLATES


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
        write(path, title="Shaking table, three storeys", scale="2.0")
        return [path], "data: measured, a three-storey model on a shaking table (northridge)"
    text, frequencies = simulated()
    write_atomically(measured, lambda p: p.write_text(text, encoding="utf-8"))
    write(
        path,
        synthetic=True,
        title="Simulated, three storeys",
        scale="0.5",
        file=measured.name,
        frequencies=", ".join(f"{f:.3f}" for f in frequencies),
    )
    return [path, measured], f"data: simulated, in {measured.name}, {reason}"


def write(path, **values):
    """Fill the template."""
    text = TEMPLATES.get_template("example.toml").render(values)
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
