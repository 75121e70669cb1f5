"""Structures of posterior draws: which draws, and what a function of their variables makes of them."""

import inspect
import warnings
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.simulators import has_response, request


class PredictionWarning(UserWarning):
    """Draws of a posterior that describe no structure are left out of a prediction."""


class StructureDraws(NamedTuple):
    """Structures of posterior draws: those that have a response.

    Attributes
    ----------
    parameters : tuple of arrays (sample, ...)
        mass, stiffness, Rayleigh pair and damping ratios.
    requests : list of Request
        For each record, with all settings but the quantity.
    labels : dict
        Coordinates `chain` and `draw` (sample,) of where each structure comes from.
    used : bool array (chain, draw)
        Of the chosen draws, those that have a response; in their order, the samples.
    """

    parameters: tuple
    requests: list
    labels: dict
    used: np.ndarray

    @property
    def attrs(self) -> dict:
        """How many draws were used and left out."""
        return {"draws_used": int(self.used.sum()), "draws_left_out": int((~self.used).sum())}


def structure_draws(idata, structure, records, draws, random_seed, **settings) -> StructureDraws:
    """Structures of at most `draws` draws, evenly spaced along each chain.

    Parameters
    ----------
    records : list of Record
        A structure without a response to one of them, at its step, is left out.
    **settings
        Of `request`.
    """
    for one in records:
        if not hasattr(one, "acceleration"):
            raise TypeError(
                f"`record` must be a Record, got {type(one).__name__}. "
                "Use read_record(path) or Record(acceleration, dt)."
            )
    posterior = posterior_of(idata)
    names = matched(structure, posterior)
    chosen = thin(posterior[names], draws, random_seed)
    used, built, reasons = build(structure, chosen, names)
    refuse_none(used, reasons)
    n_dof = checked(built)
    requests = [request(n_dof, one.dt, **settings) for one in records]
    parameters = tuple(np.array(rows) for rows in zip(*(one.parameters() for one in built), strict=True))
    steps = {one.dt / asked.substeps for one, asked in zip(records, requests, strict=True)}
    valid = np.logical_and.reduce([has_response(parameters, step, requests[0].n_modes) for step in steps])
    used[used] = valid
    refuse_none(used, reasons)
    warn_of_the_others(used, reasons)
    labels = np.meshgrid(*(chosen[dim].values for dim in ("chain", "draw")), indexing="ij")
    labels = {dim: ("sample", v[used]) for dim, v in zip(("chain", "draw"), labels, strict=True)}
    return StructureDraws(tuple(values[valid] for values in parameters), requests, labels, used)


def posterior_of(idata) -> xr.Dataset:
    """The posterior group, or the Dataset itself."""
    found = idata
    if isinstance(idata, xr.DataTree):
        found = (idata["posterior"] if "posterior" in idata.children else idata).to_dataset()
    if not isinstance(found, xr.Dataset) or not {"chain", "draw"} <= set(found.dims):
        raise ValueError(
            "`idata` must be a DataTree with a group `posterior`, or a Dataset (chain, draw, ...), got "
            f"{type(idata).__name__}. Pass what pm.sample() or sample_smc() returned."
        )
    return found.assign_coords({dim: found[dim] for dim in ("chain", "draw")})


def matched(structure, posterior) -> list[str]:
    """Variables of the posterior that `structure` takes, by the names of its parameters."""
    if not callable(structure):
        raise TypeError(
            f"`structure` must be a function of posterior variables, got {type(structure).__name__}. "
            "Pass for example lambda theta: paper.chain(theta)."
        )
    known = [str(name) for name, v in posterior.data_vars.items() if {"chain", "draw"} <= set(v.dims)]
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    asked = inspect.signature(structure).parameters.values()
    names = [p.name for p in asked if p.kind in by_name and p.name in known]
    needed = [
        p.name
        for p in asked
        if p.default is p.empty and p.name not in names and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]
    if needed or not names:
        got = ", ".join(needed or [p.name for p in asked]) or "none"
        raise ValueError(
            f"`structure` must have parameters named like posterior variables ({', '.join(known)}), "
            f"got {got}. Rename them, or give others a default."
        )
    return names


def thin(posterior, draws, random_seed) -> xr.Dataset:
    """Equally many draws of each chain, evenly spaced from a random start: closest to independent."""
    if isinstance(draws, bool) or int(draws) != draws or draws < 1:
        raise ValueError(f"`draws` must be a positive integer, got {draws}.")
    n_chains, n = posterior.sizes["chain"], posterior.sizes["draw"]
    wanted = min(n, max(1, int(draws) // n_chains))
    start = np.random.default_rng(random_seed).random() if wanted < n else 0.0
    return posterior.isel(draw=((np.arange(wanted) + start) * n / wanted).astype(int))


def build(structure, chosen, names):
    """Whether each draw (chain, draw) has a structure, those structures, and why others have none."""
    columns = [chosen[name].transpose("chain", "draw", ...).values for name in names]
    used = np.zeros((chosen.sizes["chain"], chosen.sizes["draw"]), dtype=bool)
    built, reasons = [], []
    for index in np.ndindex(used.shape):
        try:
            built.append(structure(**{n: c[index] for n, c in zip(names, columns, strict=True)}))
            used[index] = True
        except ValueError as error:  # structures refuse impossible numbers
            reasons.append(str(error))
    return used, built, reasons


def checked(structures) -> int:
    """The number of degrees of freedom that all structures have."""
    for one in structures:
        if not hasattr(one, "parameters") or not hasattr(one, "n_dof"):
            raise TypeError(
                f"`structure` must return a structure, got {type(one).__name__}. Return a SpringMassChain."
            )
        if one.family != "chain":
            raise TypeError(
                f"`structure` must return a SpringMassChain, got {type(one).__name__}. "
                "Call `simulate` for each draw and take the quantiles of the results."
            )
        if one.is_symbolic:
            raise TypeError(
                "`structure` must return a structure of numbers, got PyTensor variables. Its arguments are "
                "the numbers of one draw: compute with NumPy."
            )
    sizes = sorted({one.n_dof for one in structures})
    if len(sizes) > 1:
        raise ValueError(
            f"`structure` must have the same degrees of freedom for every draw, got {sizes}. "
            "Predict with one structure at a time."
        )
    return sizes[0]


def refuse_none(used, reasons):
    """Refuse to go on without any structure."""
    if not used.any():
        raise ValueError(
            f"`structure` must have a response for some draws, got none of {used.size}{because(reasons)}"
        )


def warn_of_the_others(used, reasons):
    """Say how many draws are left out, and why the first of them."""
    if not used.all():
        warnings.warn(
            f"{int((~used).sum())} of {used.size} draws have no response and are left out{because(reasons)}",
            PredictionWarning,
            stacklevel=4,
        )


def because(reasons) -> str:
    """The first reason, if one is known."""
    return f": {reasons[0]}" if reasons else ". Their frequencies or damping are not finite."
