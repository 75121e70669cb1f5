"""ModalFeature: identified frequencies and mode shapes, matched with the model's inside the likelihood.

`match_modes` tells afterwards which mode of the model each took, and warnings say where that is no partner.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pymc.distributions.distribution import Continuous
from pytensor.compile.mode import Mode
from pytensor.graph.replace import vectorize_graph
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import (
    as_list,
    check_group,
    check_model,
    check_name,
    check_number,
    check_text,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.data import demand
from pymc_features.modal.identified import Identified, identified
from pymc_features.modal.matching import (
    ModalFeatureRV,
    Parameters,
    log_densities,
    matched,
    one_minus_mac,
    variances,
)
from pymc_features.modal.structural_modes import SymbolicModes
from pymc_features.ops import as_tensor, known_dims
from pymc_features.ops.declared import IN_PYTHON, cheap_values_at_start, positive_tensor, values_at_start

BY_ENTRY = "NORMAL"  # the law of each entry of a shape
#: Degrees of freedom of 1 - MAC, which count for nothing by entry.
DENSITIES = {"TN": 1.0, "EXP": 2.0, BY_ENTRY: 1.0}
OFTEN = Mode(linker="py", optimizer="fast_run")
ROWS = 256  # draws in one call


class ModalFeature(Continuous):
    r"""Likelihood of identified natural frequencies, mode shapes and damping ratios.

    .. math::

        \ln \hat f_i \sim \mathcal{N}(\ln f_r, s_i^2 + \sigma_f^2), \qquad
        \ln \hat\zeta_i \sim \mathcal{N}(\ln \zeta_r, t_i^2 + \sigma_\zeta^2), \qquad
        \frac{1 - \mathrm{MAC}_{ir}}{\sigma_\phi^2} \sim \chi^2_m, \qquad
        1 - \mathrm{MAC}_{ir} = \min_a \frac{\| a \phi_r - \hat\phi_i \|^2}{\| \hat\phi_i \|^2}

    The last is the mean-square discrepancy of Eq. (3) for a shape, whose scale and sign mean nothing, so that
    the densities of the source carry over: m = 1 is TN, Eq. (7), m = 2 EXP, Eq. (9).

    Which mode r of the model an identification is of is decided inside the likelihood, at each evaluation:
    each takes a mode of its own, such that the log-likelihood is largest.

    Parameters
    ----------
    modes : SymbolicModes, or tuple of frequencies (m,) [Hz], shapes (m, s) and damping ratios (m,)
        Of the model, from `modes`, at the channels of the data: more of them than were identified, so that
        none leaves the list where modes change places. Damping ratios may be left out without `sigma_zeta`.
    observed : ModalData, mapping or array_like (i,)
        Identified modes: `frequencies` (i,) [Hz]; `shapes` (i, s) or None, real or complex, of any scale and
        sign, NaN where an entry is missing; `frequency_sd` (i,) [Hz] or None; `damping_ratios` and
        `damping_sd` (i,) or None, fractions of critical, NaN where they are not known; `shape_sd` (i, s) or
        None, in the scale of the shapes. An array stands for frequencies alone. Shapes with fewer than two
        entries say nothing and are left out.
    sigma_f : tensor_like () or (g,)
        Standard deviation of ln f that is not in `frequency_sd` [-]: the error of the model, one or one for
        each mode. Positive, or zero where each frequency has a standard deviation.
    sigma_phi : tensor_like () or (g,), optional
        Scale of the root of 1 - MAC [-], positive; needed with shapes. The law of 1 - MAC is not cut off at
        1: it should be well below 0.5. With ``density="NORMAL"`` the error of the model in each entry over
        the root mean square of all entries; it may be zero where each entry has a standard deviation.
    sigma_zeta : tensor_like () or (g,), optional
        Standard deviation of ln zeta that is not in `damping_sd` [-]: the error of the model, often 0.2 and
        more. Positive, or zero where each ratio has a standard deviation. Without it damping ratios are not
        compared.
    density : {"EXP", "TN", "NORMAL"} or tensor_like () or (g,)
        Law of 1 - MAC, or its degrees of freedom m, positive. "NORMAL": each entry of a real shape is normal,
        with `shape_sd` and `sigma_phi`, see Notes.
    labels : sequence (i,), optional
        Which mode each identification is of, where there are several of one: those of equal labels take the
        same mode of the model, and share its error. By default those of the data, as `read_modal` finds
        them, else each is of a mode of its own.
    dims : tuple of str, optional
        Names of the two axes of the data. By default `{name}_mode`, with the labels, and `{name}_entry`.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, the model has fewer modes than were identified, damping ratios are missing
        where they are asked for, or a number is not positive.

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
        \ln p = -\frac{1}{2} [\, m \ln |C| + \mathrm{tr}(C^{-1} D) \,], \quad D_{ij} = d_i \cdot d_j

    with b integrated out in closed form; likewise ln zeta, with t_i the ratio of `damping_sd` to the damping
    ratio. The scatter is `frequency_sd`, or where there is none the deviation from the mean of each mode,
    pooled over modes; that of damping and shapes is pooled likewise (at least 1e-4, as numbers of a table are
    rounded). Tests that scatter more than `frequency_sd` says should come without it.

    **Entries with standard deviations of their own** (``density="NORMAL"``): with x_i a measured shape over
    its root mean square, s_ij of `shape_sd` in that scale,

    .. math::

        x_i = a_i \phi_r + b + n_i, \qquad b_j \sim \mathcal{N}(0, \sigma_\phi^2), \qquad
        n_{ij} \sim \mathcal{N}(0, s_{ij}^2)

    where the error of the model b is one for all identifications of a mode. The scale and sense a_i of each
    is free, with a flat density of the length of a_i phi_r. Both are integrated out in closed form: what is
    left is the density of the part of the shapes across phi_r (tests/modal/test_damping.py).

    One log-likelihood value for each mode, however many identifications it has, so that LOO leaves out a mode
    with all its tests. A draw has a frequency, a damping ratio where it is compared, and a shape of length
    one (of a root mean square of one with "NORMAL") for each identification, of the mode that the data are
    matched with, and along `{name}_entry` one after another; missing entries are zero.

    References
    ----------
    Eqs. (3), (7) and (9) of the source. M. W. Vanik, J. L. Beck & S.-K. Au, J. Eng. Mech. 126 (2000) 738-745:
    modal data in Bayesian updating.

    Examples
    --------
    One mode, of 2 Hz and 2 % in the model: ln f is 0.02 off and ln zeta 0.3, errors are 0.02 and 0.3, so
    that the log-likelihood is -ln(2 pi 0.02 0.3) - 1/2 - 1/2.

    >>> observed = {"frequencies": [2.0 * np.exp(0.02)], "damping_ratios": [0.02 * np.exp(0.3)]}
    >>> with pm.Model() as model:
    ...     found = [2.0], np.zeros((1, 0)), [0.02]
    ...     y = ModalFeature("y", found, observed=observed, sigma_f=0.02, sigma_zeta=0.3)
    ...     print(model.logp().eval().round(6), round(-np.log(2.0 * np.pi * 0.02 * 0.3) - 1.0, 6))
    2.278119 2.278119
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
        sigma_zeta: TensorLike | None = None,
        density: str | TensorLike = "EXP",
        labels: Sequence | None = None,
        dims: Sequence[str] | None = None,
    ) -> TensorVariable:
        check_name(name)
        data, dims = identified(observed, labels, damping=sigma_zeta is not None), known_dims(dims, 2)
        if dims is None:
            dims = add_coordinates(name, data)
        parameters = checked_parameters(modes, data, sigma_f, sigma_phi, density, sigma_zeta)
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


def checked_parameters(
    modes, data: Identified, sigma_f, sigma_phi, density, sigma_zeta=None
) -> list[TensorVariable]:
    """Parameters of the random variable, in its order."""
    advice = "Pass what `modes` returned."
    if not (listed := as_list(modes)):
        raise TypeError(message("modes", "frequencies (m,) and shapes (m, s)", shown(modes)))
    found = [*listed, *(None, np.zeros((0, 0)), np.zeros(0))[len(listed) :]][:3]
    frequencies, shapes, ratios = found = [as_tensor(x, "modes", advice) for x in found]
    ndims = [x.ndim for x in found]
    what = "`modes` must be frequencies (m,), shapes (m, s) and perhaps damping ratios (m,)"
    demand(ndims == [1, 2, 1], what, "{}, {} and {} dimensions".format(*ndims), advice)
    (g, _, s), [m], [_, columns] = data.shapes.shape, frequencies.type.shape, shapes.type.shape
    what = f"`modes` must have at least as many modes as were identified, {g}"
    demand(m is None or m >= g, what, m, "Ask `modes` for more.")
    what = f"`shapes` must have a column for each of the {columns} sensors of `modes`"
    demand(not s or columns in (None, s), what, s, "Pass the channels of the data as `sensors`.")
    advice = "Pass the scale of the root of 1 - MAC."
    demand(not s or sigma_phi is not None, "`sigma_phi` must be given with shapes", None, advice)
    what = "`modes` must have damping ratios (m,) where `sigma_zeta` is given"
    is_whole, advice = data.damping is None or len(listed) > 2, "Pass what `modes` returned."
    demand(is_whole, what, "frequencies and shapes alone", advice)
    if isinstance(density, str):
        what = message("density", f"one of {', '.join(DENSITIES)} or degrees of freedom", shown(density))
        require(density in DENSITIES, what)
    by_entry = isinstance(density, str) and density == BY_ENTRY
    what = f'`shapes` must be real for density="{BY_ENTRY}"'
    advice = "Pass `observed.real()`, or another density."
    demand(not (by_entry and data.is_complex), what, "complex ones", advice)
    sigma_phi, sigma_zeta = (1.0 if sigma is None else sigma for sigma in (sigma_phi, sigma_zeta))
    parameters = Parameters(
        frequencies,
        np.zeros(0) if data.damping is None else ratios,
        pt.specify_shape(shapes, (None, s)) if s else shapes[:, :0],
        scale("sigma_f", sigma_f, g, data.frequencies, data.sd),
        scale("sigma_zeta", sigma_zeta, g, data.damping, data.damping_sd),
        scale("sigma_phi", sigma_phi, g, data.shapes if by_entry else None, data.shape_sd),
        scale("density", DENSITIES[density] if isinstance(density, str) else density, g),
        *data.scatter(by_entry and s > 1),
        data.known,
        np.zeros((g, 0)),
    )
    parameters = Parameters(*map(pt.as_tensor_variable, parameters))
    match = matched(log_densities(pt.as_tensor_variable(data.values), parameters))
    return list(parameters._replace(match=match))


def scale(name, value, n, values=None, sd=None):
    """A tensor (n,); numbers are refused where not positive, or zero where all values have an sd."""
    allow_zero = values is not None and (sd[~np.isnan(values)] > 0.0).all()
    tensor = positive_tensor(value, name, zero=allow_zero)
    what = message(name, f"one value or one for each of the {n} modes", tensor.type.shape)
    require(tensor.type.shape in ((), (None,), (1,), (n,)), what)
    return pt.broadcast_to(tensor, (n,))


def partners_of(rv) -> tuple[list[str], dict[str, TensorVariable]]:
    """Names of identifications (i,), and their partners (i,) under the parameters of a `ModalFeature`.

    A name is the label of its mode, with a number where that has several identifications.
    """
    model, p = pm.modelcontext(None), Parameters(*rv.owner.inputs[2:])
    value, (there, _, masks) = model.rvs_to_values[rv], p.split(p.known)
    known = there.eval(mode=IN_PYTHON)
    rows, several = np.nonzero(known), known.sum(axis=1) > 1
    dim, *_ = model.named_vars_to_dims.get(rv.name, (None,))
    labels = model.coords.get(dim) or range(len(known))
    names = [f"{labels[g]}.{j}" if several[g] else f"{labels[g]}" for g, j in zip(*rows, strict=True)]
    measured, _, parts = p.split(value)
    chosen = matched(log_densities(value, p))[rows[0]]
    frequency = pt.dot(chosen, p.frequencies)
    mac = pt.full_like(frequency, np.nan)
    if masks:
        mask = masks[0][rows]
        e = pt.sum(chosen * one_minus_mac(p.shapes, [part[rows] for part in parts], mask), axis=-1)
        mac = pt.switch(pt.any(mask > 0.0, axis=-1), 1.0 - e, np.nan)
    sd = pt.sqrt(sum(variances(p.sigma_f, p.sd_f, there)))[rows]
    off = (pt.log(measured[rows]) - pt.log(frequency)) / sd
    mode = pt.argmax(chosen, axis=-1)
    return names, {"model_mode": mode, "frequency": frequency, "deviation": off, "mac": mac}


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
    what = "`deviations` must be positive and `least_mac` from 0 to 1"
    demand(deviations > 0.0 and 0.0 <= least_mac <= 1.0, what, f"{deviations} and {least_mac}")
    if name is not None:
        check_text(name, "name")
    if not isinstance(posterior, xr.DataTree | xr.Dataset | None):
        raise TypeError(message("posterior", "a DataTree or a Dataset of draws", shown(posterior)))
    model = check_model(model)
    found = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, ModalFeatureRV)]
    found = [rv for rv in found if name in (None, rv.name)]
    got = f"{name!r}: {', '.join(rv.name for rv in found) or 'none'} found"
    demand(len(found) == 1, "`name` must be that of one ModalFeature of the model", got)
    if isinstance(posterior, xr.DataTree):
        posterior = check_group(posterior, "posterior", "posterior", "Pass what `sample` returned.")
    sizes = {}
    if posterior is not None:
        missing = [v.name for v in model.free_RVs if v.name not in posterior]
        what = "`posterior` must have all free variables of the model"
        demand(not missing, what, f"none of {missing}")
        sizes = {dim: posterior.sizes.get(dim, 0) for dim in ("chain", "draw")}
        got = ", ".join(map(str, posterior.dims)) or "no dimensions"
        require(all(sizes.values()), message("posterior", "draws along chain and draw", got))
    with model:
        names, match = partners_of(found[0])
        evaluate = partial(values_of_draws, posterior) if sizes else values_at_start
        values = evaluate(list(match.values()), model)
    fields = {
        name: ((*sizes, "mode"), x.reshape((*sizes.values(), -1)))
        for name, x in zip(match, values, strict=True)
    }
    table = xr.Dataset(fields, {dim: posterior[dim].values for dim in sizes} | {"mode": names})
    partner = abs(table["deviation"]) <= deviations
    table["has_partner"] = partner & ((table["mac"] >= least_mac) | np.isnan(table["mac"]))
    warn_of_strangers(found[0].name, table, [*sizes])
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


def values_of_draws(posterior: xr.Dataset, variables, model) -> list[np.ndarray]:
    """Values (n, i) of variables (i,) at all draws, chain by chain."""
    draws = [posterior[v.name].transpose("chain", "draw", ...).values.astype(v.dtype) for v in model.free_RVs]
    rows = [x.reshape((-1, *x.shape[2:])) for x in draws]
    batches = [pt.tensor(dtype=v.dtype, shape=(None, *v.type.shape)) for v in model.free_RVs]
    outputs = vectorize_graph(variables, dict(zip(model.free_RVs, batches, strict=True)))
    function, parts = pytensor.function(batches, outputs, mode=OFTEN, on_unused_input="ignore"), []
    for some in np.array_split(np.arange(len(rows[0])), -(-len(rows[0]) // ROWS)):
        found = function(*(x[some] for x in rows))
        parts.append([np.broadcast_to(x, (some.size, x.shape[-1])) for x in found])
    return [np.concatenate(x) for x in zip(*parts, strict=True)]


def warn_at_start(rv):
    """Warn if the shape of an identified mode is like none at the model's initial point."""
    names, match = partners_of(rv)
    if (values := cheap_values_at_start([match["frequency"], match["mac"]])) is None:
        return
    pairs = list(zip(names, *values, strict=True))
    if listed := ", ".join(f"{name} (MAC {mac:.2f} at {f:.4g} Hz)" for name, f, mac in pairs if mac < 0.5):
        warn_caller(
            f"the shapes of these modes of {rv.name} have no partner at the model's initial point: {listed}. "
            "Ask `modes` for more modes, look at the order of the sensors; `modal.match_modes` tells of a "
            "posterior.",
            ModalMatchWarning,
        )
