"""Structures of posterior draws: which draws, and what a function of their variables makes of them."""

import inspect
import warnings
from collections.abc import Sequence
from contextlib import closing, contextmanager
from typing import NamedTuple, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import sparse

from pymc_features._checks import check_integer, check_keywords, check_seed, message
from pymc_features.exceptions import PredictionWarning
from pymc_features.prediction.ensemble import Ensemble
from pymc_features.records import DynamicLoad


class ResponseOptions(TypedDict, total=False):
    """Arguments of `response` and `simulate` that hold for every draw."""

    dt: float | None
    sensors: Sequence[int] | Sequence[str] | None
    n_modes: int | None
    outputs: ArrayLike | sparse.sparray | None


def response_options(given: dict, function: str) -> dict:
    """All of these arguments, None where not given; refuse others."""
    check_keywords(given, ResponseOptions.__annotations__, function)
    return dict.fromkeys(ResponseOptions.__annotations__) | given


def check_records(records) -> None:
    """Refuse what is no record, before any structure is made."""
    for record in records:
        if not isinstance(record, DynamicLoad):
            advice = "Use read_record(path) or Record(acceleration, dt)."
            raise TypeError(message("record", "a Record", type(record).__name__, advice))


class StructureDraws(NamedTuple):
    """Structures of posterior draws: those that have a response.

    Attributes
    ----------
    ensemble : Ensemble
        The structures, in the order of the samples.
    labels : dict
        Coordinates `chain` and `draw` (sample,) of where each structure comes from.
    used : bool array (chain, draw)
        Of the chosen draws, those that have a response; in their order, the samples.
    """

    ensemble: Ensemble
    labels: dict
    used: np.ndarray

    @property
    def attrs(self) -> dict:
        """How many draws were used and left out."""
        return {"draws_used": int(self.used.sum()), "draws_left_out": int((~self.used).sum())}


@contextmanager
def structure_draws(
    idata, structure, records, quantities, draws, random_seed, *, keep_histories=False, **settings
):
    """Structures of at most `draws` draws, evenly spaced along each chain, a `StructureDraws`.

    Parameters
    ----------
    records, quantities, keep_histories, settings
        As in `Ensemble`. A structure without a response to one of the records is left out.
    """
    posterior = posterior_of(idata)
    names = matched(structure, posterior)
    chosen = thin(posterior[names], draws, random_seed)
    used = np.zeros((chosen.sizes["chain"], chosen.sizes["draw"]), dtype=bool)
    with closing(Ensemble(records, quantities, used.size, settings, keep_histories)) as ensemble:
        reasons = take_up(ensemble, structure, chosen, names, used)
        if not used.any():
            raise ValueError(
                f"`structure` must have a response for some draws, got none of {used.size}{because(reasons)}"
            )
        warn_of_the_others(used, reasons)
        labels = np.meshgrid(*(chosen[dim].values for dim in ("chain", "draw")), indexing="ij")
        labels = {dim: ("sample", v[used]) for dim, v in zip(("chain", "draw"), labels, strict=True)}
        yield StructureDraws(ensemble, labels, used)


def posterior_of(idata) -> xr.Dataset:
    """The posterior group, or the Dataset itself."""
    found = idata
    if isinstance(idata, xr.DataTree):
        found = (idata["posterior"] if "posterior" in idata.children else idata).to_dataset()
    known = isinstance(found, xr.Dataset) and all(found.sizes.get(dim) for dim in ("chain", "draw"))
    if not known:
        raise ValueError(
            "`idata` must be a DataTree with a group `posterior`, or a Dataset (chain, draw, ...), got "
            f"{type(idata).__name__}. Pass what pm.sample() or sample_smc() returned."
        )
    return found.assign_coords({dim: found[dim] for dim in ("chain", "draw")})


def matched(structure, posterior) -> list[str]:
    """Variables of the posterior that `structure` takes, by the names of its parameters."""
    if not callable(structure) or not has_signature(structure):
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


def has_signature(function) -> bool:
    """Whether the names of its parameters are known; those of some built-in functions are not."""
    try:
        return bool(inspect.signature(function))
    except (TypeError, ValueError):
        return False


def thin(posterior, draws, random_seed) -> xr.Dataset:
    """Equally many draws of each chain, evenly spaced from a random start: closest to independent."""
    draws = check_integer(draws, "draws")
    check_seed(random_seed, states=True)
    n_chains, n = posterior.sizes["chain"], posterior.sizes["draw"]
    wanted = min(n, max(1, draws // n_chains))
    start = np.random.default_rng(random_seed).random() if wanted < n else 0.0
    return posterior.isel(draw=((np.arange(wanted) + start) * n / wanted).astype(int))


def take_up(ensemble, structure, chosen, names, used) -> list[str]:
    """Add the structure of each draw to the ensemble; mark those `used`, return why others cannot be."""
    columns = [chosen[name].transpose("chain", "draw", ...).values for name in names]
    reasons, size = [], None
    for index in np.ndindex(used.shape):
        try:
            built = structure(**{n: c[index] for n, c in zip(names, columns, strict=True)})
        except ValueError as error:  # structures refuse impossible numbers
            reasons.append(str(error))
            continue
        size = checked(built, size)
        used[index] = ensemble.add(built)
    return reasons


def checked(structure, size) -> tuple[int, int]:
    """Degrees of freedom and supports of a structure, the same as those before, `size`."""
    if not hasattr(structure, "parameters") or not hasattr(structure, "n_dof"):
        raise TypeError(
            f"`structure` must return a structure, got {type(structure).__name__}. Return a SpringMassChain."
        )
    if structure.is_symbolic:
        raise TypeError(
            "`structure` must return a structure of numbers, got PyTensor variables. Its arguments are "
            "the numbers of one draw: compute with NumPy."
        )
    found = structure.n_dof, getattr(structure, "n_supports", 1)
    for what, own, first in zip(("degrees of freedom", "supports"), found, size or found, strict=True):
        if own != first:
            raise ValueError(
                f"`structure` must have the same {what} for every draw, got {sorted((own, first))}. "
                "Predict with one structure at a time."
            )
    return found


def warn_of_the_others(used, reasons):
    """Say how many draws are left out, and why the first of them."""
    if not used.all():
        warnings.warn(
            f"{int((~used).sum())} of {used.size} draws have no response and are left out{because(reasons)}",
            PredictionWarning,
            stacklevel=5,
        )


def because(reasons) -> str:
    """The first reason, if one is known."""
    unknown = ". Their frequencies or damping are not finite, or their integration fails."
    return f": {reasons[0]}" if reasons else unknown
