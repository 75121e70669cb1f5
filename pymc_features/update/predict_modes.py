"""What the posterior says of identified modes: their partners, and the shapes of draws."""

import numpy as np
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.modal_features import match_modes
from pymc_features.update.predict import thinned
from pymc_features.update.problem.kinds import MODAL
from pymc_features.update.problem.model import declare, names_for
from pymc_features.update.problem.structure import modes_of

MATCHED_DRAWS, SHAPE_DRAWS = 500, 100


def expected(problem) -> xr.Dataset:
    """Draws of the priors of what decides on modes."""
    problem = problem.of_modes
    names = names_for(problem, MODAL.name)
    values = {
        name: (("chain", "draw"), problem.priors[name].draw(MATCHED_DRAWS, k)[None])
        for k, name in enumerate(names)
    }
    return xr.Dataset(values, {"chain": [0], "draw": np.arange(MATCHED_DRAWS)})


def matched(problem, posterior: xr.Dataset, **limits) -> xr.Dataset:
    """Which mode of the model each identified mode is matched with, of some draws; see `match_modes`.

    Its dimension is `identified`, with the numbers of the modes in their file. `limits` are those of
    partners.
    """
    model = declare(problem.of_modes, MODAL.name)
    found = match_modes(thinned(posterior, MATCHED_DRAWS), name="modal", model=model, **limits)
    found = found.rename(mode="identified").assign_coords(identified=problem.modal.by_label)
    found = found.sel(identified=problem.modal.numbers)
    return found.assign(has_partner=found["has_partner"].astype(np.int8))


def shapes(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Frequencies [Hz] and shapes of the model at some draws; those that describe no structure are left out.

    Returns
    -------
    Dataset
        `frequency` (sample, mode); of identified shapes also `at_channels` (sample, mode, channel), and
        `at_points` (sample, mode, point) of what is drawn.
    """
    modal, names = problem.modal, problem.structure.names
    few = thinned(posterior[names], SHAPE_DRAWS)
    rows, n = np.column_stack([few[name].transpose("chain", "draw").values.ravel() for name in names]), 0
    columns = {"frequency": [], "at_channels": [], "at_points": []}
    for row in rows:
        try:
            structure = problem.structure(**dict(zip(names, map(float, row), strict=True)))
            found = modes_of(structure, modal.n_modes)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            continue
        n, rows_of_modes = n + 1, found.mode_shapes.T[: modal.n_modes]
        columns["frequency"].append(found.natural_frequencies[: modal.n_modes])
        columns["at_channels"].append(rows_of_modes[:, modal.dofs])
        if modal.points is not None:
            columns["at_points"].append(modal.points.entries(rows_of_modes))
    if not n:
        raise ConfigError("`structure` must have modes, got none at any draw of the posterior.")
    dims = {"frequency": (), "at_channels": ("channel",), "at_points": ("point",)}
    wanted = {name for name, values in columns.items() if values and np.size(values)}
    return xr.Dataset(
        {name: (("sample", "mode", *dims[name]), np.array(columns[name])) for name in dims if name in wanted},
        {"mode": 1 + np.arange(modal.n_modes)},
    )


def identified_modes(problem) -> xr.Dataset:
    """What was identified: frequency, its standard deviation [Hz], and shape (identified, channel)."""
    data = problem.modal.data
    found = {"frequency": ("identified", data.frequencies, {"units": "Hz"})}
    if data.frequency_sd is not None:
        found["frequency_sd"] = "identified", data.frequency_sd, {"units": "Hz"}
    coords = {"identified": problem.modal.numbers}
    if data.shapes is not None:
        found["shape"] = ("identified", "channel"), data.shapes
        coords |= {"channel": list(data.channels), "dof": ("channel", problem.modal.dofs)}
    return xr.Dataset(found, coords, {"source": problem.modal.source})
