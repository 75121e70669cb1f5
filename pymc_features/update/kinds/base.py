"""What every kind of data says of itself, and the PyMC model and draws of a problem that kinds share."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import Likelihood
from pymc_features.storage import fingerprint, write_atomically
from pymc_features.update.config.entries import Parameter, priors_in
from pymc_features.update.config.keys import named_key, refuse, shown
from pymc_features.update.config.sections import Section
from pymc_features.update.config.structures import modes_of
from pymc_features.update.plausibility.prior_modes import possible_modes

CHECK_DPI, REPORT_DPI = 120, 110
SENSORS = ("sensor", "degree of freedom", "peak [m/s²]", "rms [m/s²]")
QUANTILES = (0.05, 0.5, 0.95)
MODAL_DRAWS = 500


class Verdict(NamedTuple):
    """What to think of the fit: sentences, of which the first says whether the model explains the data."""

    sentences: list[str]
    explains: bool


def png(draw: Callable, dpi: float = REPORT_DPI) -> bytes:
    """What a function draws as a PNG file; the figure is released."""
    axes, buffer = draw(), io.BytesIO()
    axes[0].get_figure(root=True).savefig(buffer, dpi=dpi, format="png")
    plots.close(axes[:1])
    return buffer.getvalue()


def drawn_to(path: Path, draw: Callable) -> str:
    """Write a figure of `check`; a sentence that says so."""
    image = png(draw, CHECK_DPI)
    write_atomically(path, lambda to: to.write_bytes(image))
    return f"wrote {path}"


class KindOfData:
    """One kind of data of an update; a new one is a file beside this one and a line in `KINDS_OF_DATA`.

    Methods take the `Problem` that the data are part of, and the name of a likelihood. What they are for is
    said here; a kind says what is special about its own.
    """

    key: str  # name of its section in the file, and the section
    section: type[Section]
    own: tuple[Likelihood, ...] = ()  # likelihoods that no other kind has
    refused: dict[str, str] = {}  # sections and keys that mean nothing beside it, to what is said of them
    is_checked: bool = True  # whether `read` looks for what is wrong
    likelihoods: list[str]  # that are sampled where it is the first of a problem; others join what is sampled
    dofs: list[int]  # degree of freedom of each sensor, and the names of the sensors to them
    placed: dict[str, int] = {}
    used: str  # what they are, in words
    measures = ""  # which motion the measured responses are, and in which unit; empty without responses
    band = 0.0, np.inf  # frequencies [Hz] that the data have
    # of data that are recognised by arrays, names to arrays: with others it is another problem
    arrays: dict[str, np.ndarray] = {}
    identity = (
        ""  # what a finished part is recognised by besides; data that may be added are no other problem
    )
    beside: tuple["KindOfData", ...] = ()  # what is found in the data, and compared with the result alone

    @classmethod
    def is_asked(cls, config) -> bool:
        """Whether a file has such data."""
        return getattr(config, cls.key) is not None

    @classmethod
    def check_sections(cls, config) -> None:
        """Raise ConfigError if another section says what means nothing beside it."""
        for keys, words in cls.refused.items():
            refuse(config, keys, words)

    @classmethod
    def read(cls, problem) -> "KindOfData":
        """Read and check what the section names; a ConfigError names the key. The problem has no data yet."""
        raise NotImplementedError

    def parameters(self, likelihood: str):
        """Values of the file that are random under a likelihood, besides those of the structure."""
        return ()

    def declare(self, problem, likelihood: str, structure, values, tolerance) -> None:
        """Add what was measured to the PyMC model of the context; `values` are the variables by name."""
        raise NotImplementedError

    def sample(self, problem, likelihood: str, model, seed: int, running) -> tuple[xr.DataTree, Any] | None:
        """Posterior and its model, where it is the first of a problem; None: by the sampler of the file."""
        return None

    def predict(self, problem, likelihood: str, model, idata) -> dict[str, xr.Dataset]:
        """Groups of a result that say what a posterior makes of the data."""
        return {}

    def shared(self, problem) -> dict[str, xr.Dataset]:
        """Groups of the result of all likelihoods, by path."""
        return {}

    def prints(self) -> dict[str, str]:
        """What the data are recognised by, for settings: other data are another problem."""
        return {f"{name}_sha256": fingerprint(values) for name, values in self.arrays.items()}

    def foretold(self, problem) -> list[str]:
        """What likelihoods cannot tell, before anything is sampled."""
        return []

    def verdict(self, problem, result, kind: str) -> Verdict:
        """Judge how one likelihood of a result meets the data."""
        return Verdict([], True)

    def sentences(self, problem, result, explains: bool) -> Iterator[tuple[str, bool]]:
        """What else comes first in a report, and whether it is good news; `explains` is the verdict."""
        yield from ()

    def told(self) -> Iterator[str | dict]:
        """Sentences and tables on what was read."""
        yield from ()

    def check(self, problem, path: Path) -> Iterator[str | dict]:
        """Compare with the priors, and draw both into a file; sentences and tables on what is found."""
        yield from ()

    def tables(self, problem, result) -> list[dict]:
        """Tables of the report, as of `table`: the data, and what likelihoods make of them."""
        return []

    def figures(self, problem, result) -> dict[str, Callable]:
        """Figures that all likelihoods share: names of files without suffix to functions that draw."""
        return {}

    def figures_of(self, problem, part, kind: str) -> dict[str, Callable]:
        """Figures of one likelihood, by what follows its name in that of the file."""
        return {}


def table(name, section, title="", columns=(), rows=(), note="") -> dict:
    """A table of the report; its cells become texts. Without columns it is its note alone."""
    rows = [[str(cell) for cell in row] for row in rows]
    named = {"name": name, "section": section, "title": title}
    return named | {"columns": list(columns), "rows": rows, "note": note}


def channels_table(data, more="", base=None) -> dict:
    """Source of channels, what [processing] did, `more`, and how large they and the `base` are."""
    asked, steps = data.config.processing, [f"source is {data.source}"]
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
    n_times, places = data.channels.sizes["time"], data.placed.values() or [""] * len(data.dofs)
    note = f"The {', '.join(steps)}. There are {n_times} samples at {data.step:.6g} s{more}"
    histories = [*zip(data.channels["sensor"].values, places, data.channels.values, strict=True)]
    rows = [
        (name, dof, f"{np.nanmax(np.abs(values)):.4g}", f"{np.sqrt(np.nanmean(values**2)):.4g}")
        for name, dof, values in ([] if base is None else [("base", "", base)]) + histories
    ]
    return table("channels", "data", "Channels", SENSORS, rows, note.strip())


def check_positive(key: str, value, priors, n=None, each="", advice="", can_be_zero=False) -> None:
    """Refuse what is not positive, or has a prior that is not: one value for all, or one for each of n."""
    if n is not None and isinstance(value, list) and len(value) != n:
        raise ConfigError(f"`{key}` must be one value or one for each of the {n} {each}, got {len(value)}.")
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, float) and (one < 0.0 or (one == 0.0 and not can_be_zero)):
            wanted = "at least zero" if can_be_zero else "positive"
            raise ConfigError(f"`{key}` must be {wanted}, got {one:g}. {advice}".strip())
        if isinstance(one, Parameter) and (middle := priors[one.prior].median) <= 0.0:
            raise ConfigError(
                f"`{key}` must be positive, got the prior `priors.{one.prior}` with the median {middle:g}. "
                "Take a distribution of positive numbers."
            )


def check_dofs(key: str, dofs, size: int) -> None:
    """Refuse degrees of freedom that are not there, or named twice."""
    if len(set(dofs)) < len(dofs) or not all(0 <= dof < size for dof in dofs):
        known = f"from 0 to {size - 1}, 0 next to the base"
        raise ConfigError(f"`{key}` must be different degrees of freedom {known}, got {shown(dofs)}.")


# ---- the model, and draws ----


def kinds_of(result) -> list[str]:
    """Likelihoods in a result."""
    return [name for name, part in result.children.items() if "posterior" in part.children]


def names_for(problem, likelihood: str) -> list[str]:
    """Names of the priors in the model of one likelihood, in the order of the file."""
    used = set(problem.structure.names)
    for data in problem.data:
        used |= {item.prior for value in data.parameters(likelihood) for item in priors_in(value)}
    return [name for name in problem.priors if name in used]


def declare(problem, likelihood: str, tolerance: float | None = None) -> pm.Model:
    """The model of a problem under one likelihood of its first kind of data; `tolerance` is delta of ABC.

    It has the priors of the structure and of the errors, and all data: responses are `y` (sensor, time),
    identified modes `modal`.
    """
    with pm.Model() as model:
        values = {name: problem.priors[name].variable(name) for name in names_for(problem, likelihood)}
        with named_key("structure"):
            structure = problem.structure(**{name: values[name] for name in problem.structure.names})
        for data in problem.data:
            data.declare(problem, likelihood, structure, values, tolerance)
    return model


def draws_of_priors(problem, names, n: int) -> xr.Dataset:
    """Draws (chain, draw) of some priors."""
    columns = {
        name: (("chain", "draw"), problem.priors[name].draw(n, k)[None]) for k, name in enumerate(names)
    }
    return xr.Dataset(columns, coords={"chain": [0], "draw": np.arange(n)})


def thinned(posterior: xr.Dataset, draws: int) -> xr.Dataset:
    """At most `draws` draws, evenly spaced along each chain."""
    n = posterior.sizes["draw"]
    wanted = min(n, max(1, draws // posterior.sizes["chain"]))
    return posterior.isel(draw=(np.arange(wanted) * n / wanted).astype(int))


def modes_of_draws(problem, draws: xr.Dataset, n_modes: int | None):
    """Place (chain, draw) and modes of each draw, those without a structure left out."""
    names, shape = problem.structure.names, (draws.sizes["chain"], draws.sizes["draw"])
    columns = {name: draws[name].transpose("chain", "draw").values.ravel() for name in names}
    k = None
    for k, found in possible_modes(problem.structure, columns, lambda one: modes_of(one, n_modes)):
        yield np.unravel_index(k, shape), found
    if k is None:
        raise ConfigError("`structure` must have natural modes, got none at any draw of the posterior.")


def frequencies(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Natural frequencies [Hz] and damping ratios [-] of draws (chain, draw, mode); NaN if impossible."""
    few, found = thinned(posterior[problem.structure.names], MODAL_DRAWS), None
    for (chain, draw), one in modes_of_draws(problem, few, problem.structure.n_modes):
        if found is None:
            n_modes = one.natural_frequencies.size
            found = np.full((2, few.sizes["chain"], few.sizes["draw"], n_modes), np.nan)
        found[:, chain, draw] = one.natural_frequencies, one.damping_ratios
    dims = ("chain", "draw", "mode")
    parts = {
        "natural_frequency": (dims, found[0], {"units": "Hz"}),
        "damping_ratio": (dims, found[1], {"units": "1"}),
    }
    return xr.Dataset(parts, {"chain": few["chain"], "draw": few["draw"], "mode": 1 + np.arange(n_modes)})
