"""Which mode of the model each identified mode is matched with, and whether that is a partner."""

from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from pymc.initial_point import make_initial_point_expression
from pytensor.compile.mode import Mode
from pytensor.graph.replace import graph_replace, vectorize_graph
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorVariable

from pymc_features._checks import check_group, check_model, check_number, check_text, message, shown
from pymc_features._checks.messages import warn_caller
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal_features.density import (
    ModalFeatureRV,
    log_densities,
    masks,
    matched,
    variances,
)
from pymc_features.modal_features.identified import identification_names
from pymc_features.modal_features.mac import one_minus_mac

ONCE = Mode(linker="py", optimizer=None)
OFTEN = Mode(linker="py", optimizer="fast_run")
ROWS = 256  # draws in one call


class Match(NamedTuple):
    """Partners of identified modes, tensors (i,)."""

    mode: TensorVariable  # number of the mode of the model, 0 the lowest
    frequency: TensorVariable  # of that mode [Hz]
    deviation: TensorVariable  # (ln f^ - ln f) over its standard deviation [-]
    mac: TensorVariable  # NaN without a shape


def match_of(rv) -> Match:
    """Partners under the parameters of a `ModalFeature`."""
    value = pm.modelcontext(None).rvs_to_values[rv]
    _, _, *parameters, known, _ = rv.owner.inputs
    frequencies, shapes, *errors = parameters
    k = errors[3].type.shape[-1]
    n = known.type.shape[-1] // k
    chosen = matched(log_densities(value, *parameters, known=known))
    there, mask = masks(known, k, shapes)
    (shared, each), _ = variances(*errors, there)
    rows = np.flatnonzero(there.eval(mode=ONCE))
    value = value.reshape((-1, n))[rows]
    chosen = chosen[rows // k]
    frequency = pt.dot(chosen, frequencies)
    mac = pt.full_like(frequency, np.nan)
    if s := mask.type.shape[-1]:
        mask = mask.reshape((-1, s))[rows]
        parts = [value[:, 1 + i : 1 + i + s] for i in range(0, n - 1, s)]
        e = pt.sum(chosen * one_minus_mac(shapes, parts, mask), axis=-1)
        mac = pt.switch(pt.any(mask > 0.0, axis=-1), 1.0 - e, np.nan)
    sd = pt.sqrt(shared + each).flatten()[rows]
    return Match(pt.argmax(chosen, axis=-1), frequency, (pt.log(value[:, 0]) - pt.log(frequency)) / sd, mac)


def names_of(rv, model) -> list[str]:
    """What each identification is called, in the order of `match_of`."""
    *_, scatter, known, _ = rv.owner.inputs
    there, _ = masks(known, scatter.type.shape[-1], rv.owner.inputs[3])
    there = there.eval(mode=ONCE)
    dim, *_ = model.named_vars_to_dims.get(rv.name, (None,))
    return identification_names(model.coords.get(dim) or range(len(there)), np.nonzero(there)[0])


def match_modes(
    posterior: xr.DataTree | xr.Dataset | None = None,
    *,
    name: str | None = None,
    model: pm.Model | None = None,
    deviations: float = 3.0,
    least_mac: float = 0.5,
) -> xr.Dataset:
    """Which mode of the model each identified mode of a `ModalFeature` is matched with.

    Parameters
    ----------
    posterior : DataTree or Dataset, optional
        Draws of the model's free variables (chain, draw, ...). By default the model's initial point.
    name : str, optional
        Of the `ModalFeature`, where the model has several.
    model : pymc.Model, optional
        The model of the context by default.
    deviations : float
        A partner's frequency is at most so many standard deviations off: that of the data and sigma_f
        together.
    least_mac : float
        A partner's MAC is at least this.

    Returns
    -------
    Dataset
        With dimensions `mode` (each identification, those of one mode together), and chain and draw of a
        posterior: `model_mode`, 0 the lowest; `frequency` of that mode [Hz]; `deviation` (ln f^ - ln f) / s;
        `mac`, NaN without a shape; `has_partner`.

    Warns
    -----
    ModalMatchWarning
        Of identified modes without a partner, in more than half of the draws.
    """
    deviations, least_mac = check_number(deviations, "deviations"), check_number(least_mac, "least_mac")
    if not (deviations > 0.0 and 0.0 <= least_mac <= 1.0):
        given = f"{deviations} and {least_mac}"
        raise ValueError(f"`deviations` must be positive and `least_mac` from 0 to 1, got {given}.")
    if name is not None:
        check_text(name, "name")
    if not (posterior is None or isinstance(posterior, xr.DataTree | xr.Dataset)):
        raise TypeError(message("posterior", "a DataTree or a Dataset of draws", shown(posterior)))
    model = check_model(model)
    found = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, ModalFeatureRV)]
    found = [rv for rv in found if name in (None, rv.name)]
    if len(found) != 1:
        names = ", ".join(rv.name for rv in found) or "none"
        raise ValueError(
            f"`name` must be that of one ModalFeature of the model, got {name!r}: {names} found."
        )
    [rv] = found
    with model:
        match = match_of(rv)
    if posterior is None:
        values, dims, coords = evaluate(model, match, initial_values(model)), (), {}
    else:
        draws = posterior
        if isinstance(posterior, xr.DataTree):
            draws = check_group(posterior, "posterior", "posterior", "Pass what `sample` returned.")
        missing = [v.name for v in model.free_RVs if v.name not in draws]
        if missing:
            raise ValueError(f"`posterior` must have all free variables of the model, got none of {missing}.")
        if not all(draws.sizes.get(dim) for dim in ("chain", "draw")):
            got = ", ".join(map(str, draws.dims)) or "no dimensions"
            raise ValueError(message("posterior", "draws along chain and draw", got))
        dims = ("chain", "draw")
        coords = {dim: draws[dim].values for dim in dims}
        values = evaluate_draws(model, match, draws)
    fields = {"model_mode" if k == "mode" else k: ((*dims, "mode"), v) for k, v in values._asdict().items()}
    table = xr.Dataset(fields, coords | {"mode": names_of(rv, model)})
    partner = abs(table["deviation"]) <= deviations
    table["has_partner"] = partner & ((table["mac"] >= least_mac) | np.isnan(table["mac"]))
    warn_of_strangers(rv.name, table, dims)
    return table


def warn_of_strangers(name, table, dims):
    """Say which identified modes have no partner."""
    share = 1.0 - table["has_partner"].mean(dims)
    for label in table["mode"].values[share.values > 0.5]:
        one = table.sel(mode=label).median(dims) if dims else table.sel(mode=label)
        of_shape = "" if np.isnan(one["mac"]) else f", MAC {float(one['mac']):.2f}"
        where = f" in {float(share.sel(mode=label)):.0%} of the draws" if dims else ""
        warn_caller(
            f"mode {label} of {name} has no partner in the model{where}: the best that is left is at "
            f"{float(one['frequency']):.4g} Hz, {float(one['deviation']):.1f} standard deviations off"
            f"{of_shape}. Ask `modes` for more, leave the mode out, or look at the order of the sensors.",
            ModalMatchWarning,
        )


def initial_values(model) -> list[np.ndarray]:
    """Values of the free variables at the model's initial point."""
    expressions = make_initial_point_expression(
        free_rvs=model.free_RVs, rvs_to_transforms={}, initval_strategies=dict(model.rvs_to_initial_values)
    )
    return [np.asarray(x.eval(mode=ONCE)) for x in expressions]


def function_of(model, outputs, *, batched=False):
    """A function of the free variables, or of a batch of each, for tensors that depend on them."""
    inputs = [rv.type() for rv in model.free_RVs]
    outputs = graph_replace(outputs, dict(zip(model.free_RVs, inputs, strict=True)), strict=False)
    if batched:
        rows = [pt.tensor(dtype=x.dtype, shape=(None, *x.type.shape)) for x in inputs]
        outputs = vectorize_graph(outputs, dict(zip(inputs, rows, strict=True)))
        inputs = rows
    return pytensor.function(inputs, outputs, mode=OFTEN if batched else ONCE, on_unused_input="ignore")


def evaluate(model, match, values) -> Match:
    """Partners at one point, as arrays."""
    return Match(*function_of(model, list(match))(*values))


def evaluate_draws(model, match, draws) -> Match:
    """Partners at all draws, arrays (chain, draw, i)."""
    function = function_of(model, list(match), batched=True)
    columns = [draws[rv.name].transpose("chain", "draw", ...).values for rv in model.free_RVs]
    chains, n = columns[0].shape[:2]
    flat = [
        np.asarray(c, dtype=rv.dtype).reshape(chains * n, *c.shape[2:])
        for c, rv in zip(columns, model.free_RVs, strict=True)
    ]
    parts = [function(*(c[i : i + ROWS] for c in flat)) for i in range(0, chains * n, ROWS)]
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Match(*(x.reshape(chains, n, *x.shape[1:]) for x in joined))


def warn_at_start(rv):
    """Warn if the shape of an identified mode is like none at the model's initial point."""
    model = pm.modelcontext(None)
    try:
        match = match_of(rv)
        if any(
            v.owner is not None and getattr(v.owner.op, "expensive", False) for v in ancestors(list(match))
        ):
            return
        found = evaluate(model, match, initial_values(model))
    except Exception:  # a courtesy: whatever cannot be evaluated here is no error of the user's
        return
    strangers = np.flatnonzero(found.mac < 0.5)
    if strangers.size:
        labels = names_of(rv, model)
        listed = ", ".join(
            f"{labels[i]} (MAC {found.mac[i]:.2f} at {found.frequency[i]:.4g} Hz)" for i in strangers
        )
        warn_caller(
            f"the shapes of these modes of {rv.name} have no partner at the model's initial point: {listed}. "
            "Ask `modes` for more modes, and look at the order of the sensors; `match_modes` tells of a "
            "posterior.",
            ModalMatchWarning,
        )
