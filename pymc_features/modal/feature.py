"""ModalFeature: identified frequencies and mode shapes, matched with the model's inside the likelihood.

`match_modes` tells afterwards which mode of the model each took, and warnings say where that is no partner.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pymc.distributions.distribution import Continuous
from pymc.initial_point import make_initial_point_expression
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Constant
from pytensor.graph.replace import graph_replace, vectorize_graph
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import (
    as_list,
    check_group,
    check_model,
    check_name,
    check_number,
    check_text,
    message,
    shown,
    warn_caller,
)
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.data import refusal
from pymc_features.modal.identified import Identified, identification_names, identified
from pymc_features.modal.matching import (
    ModalFeatureRV,
    log_densities,
    masks,
    matched,
    one_minus_mac,
    variances,
)
from pymc_features.modal.structural_modes import SymbolicModes
from pymc_features.ops import as_tensor, known_dims

DENSITIES = {"TN": 1.0, "EXP": 2.0}  # degrees of freedom
ONCE = Mode(linker="py", optimizer=None)
OFTEN = Mode(linker="py", optimizer="fast_run")
ROWS = 256  # draws in one call


class ModalFeature(Continuous):
    r"""Likelihood of identified natural frequencies and mode shapes.

    .. math::

        \ln \hat f_i \sim \mathcal{N}(\ln f_r, s_i^2 + \sigma_f^2), \qquad
        \frac{1 - \mathrm{MAC}_{ir}}{\sigma_\phi^2} \sim \chi^2_m, \qquad
        1 - \mathrm{MAC}_{ir} = \min_a \frac{\| a \phi_r - \hat\phi_i \|^2}{\| \hat\phi_i \|^2}

    The last is the mean-square discrepancy of Eq. (3) for a shape, whose scale and sign mean nothing, so that
    the densities of the source carry over: m = 1 is TN, Eq. (7), m = 2 EXP, Eq. (9).

    Which mode r of the model an identification is of is decided inside the likelihood, at each evaluation:
    each takes a mode of its own, such that the log-likelihood is largest.

    Parameters
    ----------
    modes : SymbolicModes, or tuple of frequencies (m,) [Hz] and shapes (m, s)
        Of the model, from `modes`, at the channels of the data: more of them than were identified, so that
        none leaves the list where modes change places.
    observed : ModalData, mapping or array_like (i,)
        Identified modes: `frequencies` (i,) [Hz]; `shapes` (i, s) or None, real or complex, of any scale and
        sign, NaN where an entry is missing; `frequency_sd` (i,) [Hz] or None. An array stands for frequencies
        alone. Shapes with fewer than two entries say nothing and are left out.
    sigma_f : tensor_like () or (g,)
        Standard deviation of ln f that is not in `frequency_sd` [-]: the error of the model, one or one for
        each mode. Positive, or zero where each frequency has a standard deviation.
    sigma_phi : tensor_like () or (g,), optional
        Scale of the root of 1 - MAC [-], positive; needed with shapes. The law of 1 - MAC is not cut off at
        1: it should be well below 0.5.
    density : {"EXP", "TN"} or tensor_like () or (g,)
        Law of 1 - MAC, or its degrees of freedom m, positive.
    labels : sequence (i,), optional
        Which mode each identification is of, where there are several of one: those of equal labels take the
        same mode of the model, and share its error. By default those of the data, as `read_modal` finds
        them, else each is of a mode of its own.
    dims : tuple of str, optional
        Names of the two axes of the data. By default `{name}_mode`, with the labels, and `{name}_entry`.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, the model has fewer modes than were identified, or a number is not positive.

    Warns
    -----
    ModalMatchWarning
        If at the initial point of the model an identified shape has no partner, see `match_modes`; without
        `labels`, if a mode was identified twice: both are then of one mode.

    Notes
    -----
    The log-likelihood is the largest over all assignments. It is continuous wherever frequencies and shapes
    are, as a set: where modes cross, the terms only change their order
    (tests/modal/test_feature.py). Its slope jumps where the best assignment changes. It is no sum
    over assignments: where modes are closer than the data can tell apart, it counts the better of two
    explanations, not the mean of both. A poor match is a match: ask `match_modes`.

    **Several identifications of one mode** are as wrong as its model, all in the same way: their errors
    are dependent, and a hundred tests do not average the error of the model away. With d_i the part of a
    measured shape of length one that is across phi_r, channel by channel,

    .. math::

        \ln \hat f_i = \ln f_r + b + n_i, \quad b \sim \mathcal{N}(0, \sigma_f^2), \quad
        n_i \sim \mathcal{N}(0, s_i^2), \qquad
        C = \sigma_\phi^2 \, 1 1^T + \tau^2 I, \quad
        \ln p = -\tfrac{1}{2} [\, m \ln |C| + \mathrm{tr}(C^{-1} D) \,], \quad D_{ij} = d_i \cdot d_j

    with b integrated out in closed form. The scatter is `frequency_sd`, or where there is none the deviation
    from the mean of each mode, pooled over modes; that of shapes is pooled likewise (at least 1e-4, as
    numbers of a table are rounded). Tests that scatter more than `frequency_sd` says should come without it.

    One log-likelihood value for each mode, however many identifications it has, so that LOO leaves out a mode
    with all its tests. A draw has a frequency and a shape of length one for each identification, of the mode
    that the data are matched with, and along `{name}_entry` one after another; missing entries are zero.

    References
    ----------
    Eqs. (3), (7) and (9) of the source. M. W. Vanik, J. L. Beck & S.-K. Au, J. Eng. Mech. 126 (2000) 738-745:
    modal data in Bayesian updating.
    """

    rv_type = ModalFeatureRV
    rv_op = ModalFeatureRV.rv_op

    def __new__(
        cls,
        name: str,
        modes: SymbolicModes | Sequence[TensorLike],
        *,
        observed: Mapping | ArrayLike,
        sigma_f: TensorLike,
        sigma_phi: TensorLike | None = None,
        density: str | TensorLike = "EXP",
        labels: Sequence | None = None,
        dims: Sequence[str] | None = None,
    ) -> TensorVariable:
        check_name(name)
        data, dims = identified(observed, labels), known_dims(dims, 2)
        if dims is None:
            dims = add_coordinates(name, data)
        parameters = checked_parameters(modes, data, sigma_f, sigma_phi, density)
        rv = super().__new__(cls, name, *parameters, observed=data.values, dims=dims)
        warn_at_start(rv)
        return rv

    @classmethod
    def dist(cls, *parameters: TensorVariable, **kwargs) -> TensorVariable:
        """Build the random variable from what `rv_op` takes."""
        return super().dist(parameters, **kwargs)


def add_coordinates(name, data: Identified) -> tuple[str, str]:
    """Names of the axes of the data, known to the model with what stands along them."""
    coords = {f"{name}_mode": [str(label) for label in data.labels], f"{name}_entry": data.entries}
    pm.modelcontext(None).add_coords(coords)
    return tuple(coords)


def checked_parameters(modes, data: Identified, sigma_f, sigma_phi, density) -> list[TensorVariable]:
    """Parameters of the random variable, in its order."""
    listed = as_list(modes)
    if not listed:
        raise TypeError(message("modes", "frequencies (m,) and shapes (m, s)", shown(modes)))
    pair = (*listed, np.zeros((0, 0)))[:2]
    frequencies, shapes = (as_tensor(x, "modes", "Pass what `modes` returned.") for x in pair)
    if frequencies.ndim != 1 or shapes.ndim != 2:
        what = "`modes` must be frequencies (m,) and shapes (m, s)"
        got = f"{frequencies.ndim} and {shapes.ndim} dimensions"
        raise refusal(what, got, "Pass what `modes` returned.")
    (g, _, s), [m] = data.shapes.shape, frequencies.type.shape
    if m is not None and m < g:
        what = f"`modes` must have at least as many modes as were identified, {g}"
        raise refusal(what, m, "Ask `modes` for more.")
    if s and shapes.type.shape[1] not in (None, s):
        what = f"`shapes` must have a column for each of the {shapes.type.shape[1]} sensors of `modes`"
        raise refusal(what, s, "Pass the channels of the data as `sensors`.")
    shapes = pt.specify_shape(shapes, (None, s)) if s else shapes[:, :0]
    if s and sigma_phi is None:
        what, advice = "`sigma_phi` must be given with shapes", "Pass the scale of the root of 1 - MAC."
        raise refusal(what, None, advice)
    if isinstance(density, str) and density not in DENSITIES:
        what = f"one of {', '.join(DENSITIES)} or degrees of freedom"
        raise ValueError(message("density", what, shown(density)))
    degrees = DENSITIES[density] if isinstance(density, str) else density
    has_sd = bool((data.sd[~np.isnan(data.sd)] > 0.0).all())
    parameters = [
        frequencies,
        shapes,
        scale("sigma_f", sigma_f, g, allow_zero=has_sd),
        scale("sigma_phi", 1.0 if sigma_phi is None else sigma_phi, g),
        scale("density", degrees, g),
        *map(pt.as_tensor_variable, data.scatter),
    ]
    known = pt.as_tensor_variable(data.known)
    density = log_densities(pt.as_tensor_variable(data.values), *parameters, known=known)
    return [*parameters, known, matched(density)]


def scale(name, value, n, *, allow_zero=False):
    """A tensor (n,); numbers are refused where they are not positive."""
    tensor = as_tensor(value, name)
    if tensor.ndim > 1 or (tensor.ndim == 1 and tensor.type.shape[0] not in (None, 1, n)):
        raise ValueError(message(name, f"one value or one for each of the {n} modes", tensor.type.shape))
    if isinstance(tensor, Constant):
        legal = np.isfinite(tensor.data) & ((tensor.data > 0) | (allow_zero & (tensor.data == 0)))
        if not legal.all():
            raise ValueError(message(name, "positive and finite", np.asarray(tensor.data).tolist()))
    return pt.broadcast_to(tensor, (n,))


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
    """Names of the identifications, in the order of `match_of`."""
    *_, scatter, known, _ = rv.owner.inputs
    there = masks(known, scatter.type.shape[-1], rv.owner.inputs[3])[0].eval(mode=ONCE)
    dim, *_ = model.named_vars_to_dims.get(rv.name, (None,))
    return identification_names(model.coords.get(dim) or range(len(there)), there)


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
        `modal.mac`, NaN without a shape; `has_partner`.

    Warns
    -----
    ModalMatchWarning
        Of identified modes without a partner, in more than half of the draws.
    """
    deviations, least_mac = check_number(deviations, "deviations"), check_number(least_mac, "least_mac")
    if not (deviations > 0.0 and 0.0 <= least_mac <= 1.0):
        what = "`deviations` must be positive and `least_mac` from 0 to 1"
        raise refusal(what, f"{deviations} and {least_mac}")
    if name is not None:
        check_text(name, "name")
    if not (posterior is None or isinstance(posterior, xr.DataTree | xr.Dataset)):
        raise TypeError(message("posterior", "a DataTree or a Dataset of draws", shown(posterior)))
    model = check_model(model)
    found = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, ModalFeatureRV)]
    found = [rv for rv in found if name in (None, rv.name)]
    if len(found) != 1:
        got = f"{name!r}: {', '.join(rv.name for rv in found) or 'none'} found"
        raise refusal("`name` must be that of one ModalFeature of the model", got)
    [rv] = found
    if isinstance(posterior, xr.DataTree):
        posterior = check_group(posterior, "posterior", "posterior", "Pass what `sample` returned.")
    if posterior is None:
        sizes, rows = {}, [value[None] for value in initial_values(model)]
    else:
        missing = [v.name for v in model.free_RVs if v.name not in posterior]
        if missing:
            raise refusal("`posterior` must have all free variables of the model", f"none of {missing}")
        sizes = {dim: posterior.sizes.get(dim, 0) for dim in ("chain", "draw")}
        if not all(sizes.values()):
            got = ", ".join(map(str, posterior.dims)) or "no dimensions"
            raise ValueError(message("posterior", "draws along chain and draw", got))
        draws = (posterior[v.name].transpose(*sizes, ...).values.astype(v.dtype) for v in model.free_RVs)
        rows = [values.reshape((-1, *values.shape[2:])) for values in draws]
    with model:
        match = evaluate(model, match_of(rv), rows)
    fields = {
        name: ((*sizes, "mode"), values.reshape((*sizes.values(), -1)))
        for name, values in zip(("model_mode", *Match._fields[1:]), match, strict=True)
    }
    coords = {dim: posterior[dim].values for dim in sizes} | {"mode": names_of(rv, model)}
    table = xr.Dataset(fields, coords)
    partner = abs(table["deviation"]) <= deviations
    table["has_partner"] = partner & ((table["mac"] >= least_mac) | np.isnan(table["mac"]))
    warn_of_strangers(rv.name, table, [*sizes])
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


def evaluate(model, match: Match, rows) -> Match:
    """Partners, arrays (n, i), at n values of each free variable."""
    inputs = [rv.type() for rv in model.free_RVs]
    outputs = graph_replace(list(match), dict(zip(model.free_RVs, inputs, strict=True)), strict=False)
    batches = [pt.tensor(dtype=x.dtype, shape=(None, *x.type.shape)) for x in inputs]
    outputs = vectorize_graph(outputs, dict(zip(inputs, batches, strict=True)))
    n = len(rows[0]) if rows else 1
    mode = ONCE if n == 1 else OFTEN
    function, parts = pytensor.function(batches, outputs, mode=mode, on_unused_input="ignore"), []
    for start in range(0, n, ROWS):
        found = function(*(x[start : start + ROWS] for x in rows))
        parts.append([np.broadcast_to(x, (min(ROWS, n - start), x.shape[-1])) for x in found])
    return Match(*map(np.concatenate, zip(*parts, strict=True)))


def warn_at_start(rv):
    """Warn if the shape of an identified mode is like none at the model's initial point."""
    model = pm.modelcontext(None)
    try:
        match = match_of(rv)
        if any(
            v.owner is not None and getattr(v.owner.op, "expensive", False) for v in ancestors(list(match))
        ):
            return
        found = evaluate(model, match, [value[None] for value in initial_values(model)])
        frequency, agreement = found.frequency[0], found.mac[0]
    except Exception:  # a courtesy: whatever cannot be evaluated here is no error of the user's
        return
    strangers = np.flatnonzero(agreement < 0.5)
    if strangers.size:
        labels = names_of(rv, model)
        listed = ", ".join(
            f"{labels[i]} (MAC {agreement[i]:.2f} at {frequency[i]:.4g} Hz)" for i in strangers
        )
        warn_caller(
            f"the shapes of these modes of {rv.name} have no partner at the model's initial point: {listed}. "
            "Ask `modes` for more modes, look at the order of the sensors; `modal.match_modes` tells of a "
            "posterior.",
            ModalMatchWarning,
        )
