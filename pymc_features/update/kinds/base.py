"""What every kind of data says of itself, and the PyMC model and draws of a problem that kinds share."""

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import Likelihood
from pymc_features.storage import fingerprint, write_atomically
from pymc_features.update.config.entries import Parameter, evaluated, priors_in
from pymc_features.update.config.keys import named_key, refuse, shown
from pymc_features.update.config.sections import Section
from pymc_features.update.config.structures import modes_of
from pymc_features.update.plausibility.findings import possible_modes

CHECK_DPI, REPORT_DPI = 120, 110
SENSORS = ("sensor", "degree of freedom", "peak [m/s²]", "rms [m/s²]")
QUANTILES = (0.05, 0.5, 0.95)
MODAL_DRAWS = 500
SHAPES, MODES = 100, 10  # draws, and modes at least
MOST_POINTS = 1000  # of a shape that is drawn


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


def printed(arrays) -> dict[str, str]:
    """What arrays are recognised by in settings, by their names; None is left out."""
    known = {name: values for name, values in arrays.items() if values is not None}
    return {f"{name}_sha256": fingerprint(values) for name, values in known.items()}


class KindOfData:
    """One kind of data of an update; a new one is a file beside this one and a line in `KINDS_OF_DATA`.

    Methods take the `Problem` that the data are part of, and the name of a likelihood. What they are for is
    said here; a kind says what is special about its own.
    """

    key: str  # name of its section in the file, and the section
    section: type[Section]
    asked: Section  # what the file says
    own: tuple[Likelihood, ...] = ()  # likelihoods that no other kind has
    refused: dict[str, str] = {}  # sections and keys that mean nothing beside it, to what is said of them
    is_checked: bool = True  # whether `read` looks for what is wrong
    likelihoods: list[str]  # that are sampled where it is the first of a problem; others join what is sampled
    dofs: list[int]  # degree of freedom of each sensor, and the names of the sensors to them
    placed: dict[str, int] = {}
    used: str  # what they are, in words
    measures = ""  # which motion the measured responses are, and in which unit; empty without responses
    band = 0.0, np.inf  # frequencies [Hz] that the data have
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

    def parameters(self, likelihood: str) -> dict[str, Any]:
        """Values of the file that may be random under a likelihood, besides those of the structure."""
        return {at.rpartition(".")[2]: value for at, _, value in self.asked.parameters(self.key)}

    def variables(self, likelihood: str, values) -> dict[str, Any]:
        """Those that the file has as tensors, with the variables `values` in place of names of priors."""
        given = {name: value for name, value in self.parameters(likelihood).items() if value is not None}
        return {name: pt.as_tensor_variable(evaluated(value, values)) for name, value in given.items()}

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
        """What the data are recognised by, see `printed`: with other data it is another problem."""
        return {}

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

    def figures_of(self, problem, part, kind: str) -> dict[str, Callable]:
        """Figures of one likelihood, functions that draw by what follows its name in that of the file."""
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
        used |= {item.prior for value in data.parameters(likelihood).values() for item in priors_in(value)}
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
    shape = draws.sizes["chain"], draws.sizes["draw"]
    columns = {n: draws[n].transpose("chain", "draw").values.ravel() for n in problem.structure.names}
    k = None
    for k, found in possible_modes(problem.structure, columns, lambda one: modes_of(one, n_modes)):
        yield np.unravel_index(k, shape), found
    if k is None:
        raise ConfigError("`structure` must have natural modes, got none at any draw of the posterior.")


def frequencies(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Natural frequencies [Hz] and damping ratios [-] of draws (chain, draw, mode); NaN if impossible."""
    few, dims = thinned(posterior[problem.structure.names], MODAL_DRAWS), ("chain", "draw", "mode")
    modes = modes_of_draws(problem, few, problem.structure.n_modes)
    numbers = {at: (one.natural_frequencies, one.damping_ratios) for at, one in modes}
    n_modes = next(iter(numbers.values()))[0].size
    found = np.full((2, few.sizes["chain"], few.sizes["draw"], n_modes), np.nan)
    for at, pair in numbers.items():
        found[:, *at] = pair
    columns = zip(("natural_frequency", "damping_ratio"), found, ("Hz", "1"), strict=True)
    parts = {name: (dims, values, {"units": unit}) for name, values, unit in columns}
    return xr.Dataset(parts, {"chain": few["chain"], "draw": few["draw"], "mode": 1 + np.arange(n_modes)})


class Points(NamedTuple):
    """What is drawn of a shape."""

    dofs: np.ndarray  # (p,) degree of freedom of each point, -1 of one that is held
    nodes: dict | None  # as `plots.mode_shapes` takes it; None for the storeys of a chain

    def entries(self, shapes: np.ndarray) -> np.ndarray:
        """Take the points (..., p) of shapes (..., n_dof), zero where they are held."""
        return np.where(self.dofs < 0, 0.0, shapes[..., self.dofs])

    def of(self, dofs) -> list[int]:
        """The point of each of some degrees of freedom."""
        found = self.dofs.tolist()
        return [found.index(dof) for dof in dofs]


def points_of(problem) -> Points:
    """What is drawn of a mode shape: nodes of a file, or degrees of freedom along their numbers."""
    modal, n = problem.modal, problem.expected.n_dof
    if modal is not None and modal.nodes is not None:
        return modal.nodes
    kept = np.unique(np.linspace(0, n - 1, min(n, MOST_POINTS)).astype(int))
    return Points(np.union1d(kept, [*problem.first.dofs, *(modal.dofs if modal else [])]).astype(int), None)


def geometry(problem) -> xr.Dataset:
    """Places [m] of the points that are drawn, the directions in which they move, and lines between them."""
    points, modal = points_of(problem), problem.modal
    n, drawn = len(points.dofs), points.dofs.tolist()
    style = "storeys" if problem.structure.has_storeys else "entries"
    places, lines = np.outer(1.0 + points.dofs, [0.0, 0.0, 1.0]), [list(range(n))]
    directions = [[1.0, 0.0, 0.0]] * n
    if points.nodes is not None:
        style, lines = "nodes", points.nodes["lines"]
        places = np.array(points.nodes["coordinates"], dtype=float)
        spread = np.ptp(places, axis=0)  # along x where heights differ most, else along z
        default = [1.0, 0.0, 0.0] if spread[2] >= spread.max() > 0.0 else [0.0, 0.0, 1.0]
        directions = points.nodes.get("directions", [default] * n)
    sensors = {name: drawn.index(dof) for name, dof in problem.first.placed.items() if dof in drawn}
    attrs = {"style": style, "lines": json.dumps(lines), "sensors": json.dumps(sensors)}
    if modal is not None and len(modal.dofs):
        attrs["channels"] = json.dumps(points.of(modal.dofs))
    axes = ("point", "axis")
    columns = {"place": (axes, places), "direction": (axes, np.array(directions, dtype=float))}
    return xr.Dataset(columns, {"dof": ("point", points.dofs)}, attrs)


def mode_shapes(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Mode shapes of the model at some draws, the first of which is the one nearest to the medians.

    `shape` (sample, mode, point) has a largest entry of 1 and the sign of the first sample; `frequency`
    (sample, mode) is in Hz.
    """
    points, draws = points_of(problem), posterior[problem.structure.names]
    wanted = max(problem.structure.n_modes or MODES, 0 if problem.modal is None else problem.modal.n_modes)
    away = (((draws - draws.median()) / draws.std()) ** 2).to_dataarray().sum("variable")
    nearest = {dim: [int(at)] for dim, at in away.argmin(["chain", "draw"]).items()}
    chosen = draws.isel(nearest), thinned(draws, SHAPES)
    found = [modes for few in chosen for _, modes in modes_of_draws(problem, few, wanted)]
    shapes = np.array([points.entries(one.mode_shapes.T[:wanted]) for one in found])
    largest = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=-1)[..., None], axis=-1)
    shapes = shapes / np.where(largest == 0.0, 1.0, largest)
    shapes *= np.where((shapes * shapes[0]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    values = np.array([one.natural_frequencies[:wanted] for one in found])
    return xr.Dataset(
        {
            "shape": (("sample", "mode", "point"), shapes.astype(np.float32)),
            "frequency": (("sample", "mode"), values, {"units": "Hz"}),
        },
        {"mode": 1 + np.arange(values.shape[1])},
    )
