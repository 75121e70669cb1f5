"""ModalFeature: identified frequencies and mode shapes, matched with the model's inside the likelihood."""

from collections.abc import Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.distribution import Continuous
from pytensor.graph.basic import Constant
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import as_list, check_name, message, shown
from pymc_features.modal_features.density import ModalFeatureRV, log_densities, matched
from pymc_features.modal_features.identified import Identified, identified
from pymc_features.modal_features.match import warn_at_start
from pymc_features.modal_features.quantities import SymbolicModes
from pymc_features.ops import as_tensor, known_dims

DENSITIES = {"TN": 1.0, "EXP": 2.0}  # degrees of freedom


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
    (tests/modal_features/test_feature.py). Its slope jumps where the best assignment changes. It is no sum
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
        rv = super().__new__(cls, name, *parameters, observed=data.by_label, dims=dims)
        warn_at_start(rv)
        return rv

    @classmethod
    def dist(cls, *parameters: TensorVariable, **kwargs) -> TensorVariable:
        """Build the random variable from what `rv_op` takes."""
        return super().dist(parameters, **kwargs)


def add_coordinates(name, data: Identified) -> tuple[str, str]:
    """Names of the axes of the data, known to the model with what stands along them."""
    coords = {f"{name}_mode": [str(label) for label in data.labels], f"{name}_entry": data.entries_by_label}
    pm.modelcontext(None).add_coords(coords)
    return tuple(coords)


def checked_parameters(modes, data: Identified, sigma_f, sigma_phi, density) -> list[TensorVariable]:
    """What the random variable takes, in its order."""
    listed = as_list(modes)
    if not listed:
        raise TypeError(message("modes", "frequencies (m,) and shapes (m, s)", shown(modes)))
    pair = (*listed, np.zeros((0, 0)))[:2]
    frequencies, shapes = (as_tensor(x, "modes", "Pass what `modes` returned.") for x in pair)
    if frequencies.ndim != 1 or shapes.ndim != 2:
        raise ValueError(
            "`modes` must be frequencies (m,) and shapes (m, s), got "
            f"{frequencies.ndim} and {shapes.ndim} dimensions. Pass what `modes` returned."
        )
    g, s = len(data.labels), data.shapes.shape[1]
    if frequencies.type.shape[0] is not None and frequencies.type.shape[0] < g:
        raise ValueError(
            f"`modes` must have at least as many modes as were identified, {g}, got "
            f"{frequencies.type.shape[0]}. Ask `modes` for more."
        )
    if s and shapes.type.shape[1] not in (None, s):
        raise ValueError(
            f"`shapes` must have a column for each of the {shapes.type.shape[1]} sensors of `modes`, got "
            f"{s}. Pass the channels of the data as `sensors`."
        )
    shapes = pt.specify_shape(shapes, (None, s)) if s else shapes[:, :0]
    if s and sigma_phi is None:
        raise ValueError(
            "`sigma_phi` must be given with shapes, got None. Pass the scale of the root of 1 - MAC."
        )
    if isinstance(density, str) and density not in DENSITIES:
        raise ValueError(
            message("density", f"one of {', '.join(DENSITIES)} or degrees of freedom", shown(density))
        )
    degrees = DENSITIES[density] if isinstance(density, str) else density
    parameters = [
        frequencies,
        shapes,
        scale("sigma_f", sigma_f, g, allow_zero=bool((data.sd > 0).all())),
        scale("sigma_phi", 1.0 if sigma_phi is None else sigma_phi, g),
        scale("density", degrees, g),
        *map(pt.as_tensor_variable, data.scatter),
    ]
    known = pt.as_tensor_variable(data.known_by_label)
    return [
        *parameters,
        known,
        matched(log_densities(pt.as_tensor_variable(data.by_label), *parameters, known=known)),
    ]


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
