"""Free parameters of a model: their values, names, and the way to the unconstrained space and back."""

from collections.abc import Callable

import numpy as np
import pytensor.tensor as pt
import xarray as xr
from pymc.initial_point import make_initial_point_expression
from pymc.pytensorf import compile as compile_function
from pymc.vartypes import discrete_types
from pytensor.graph.replace import graph_replace

from pymc_features._checks import as_numbers, check_finite, check_group, check_mapping, message
from pymc_features.smc.density.prior import kept_for
from pymc_features.smc.density.rows import ONE_CALL

SAME_MODEL = "Pass what `sample` returned for the same model."


def check_continuous(model, purpose: str):
    """Refuse models without free parameters, or with discrete ones."""
    names = [rv.name for rv in model.free_RVs if rv.dtype in discrete_types]
    if names or not model.free_RVs:
        got = f"discrete ones: {', '.join(names)}" if names else "none"
        raise ValueError(
            f"`model` must have continuous free parameters for {purpose}, got {got}. Use sample_smc()."
        )


def entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """Names of the entries of one parameter: k, or k[0], k[1]."""
    if shape == ():
        return [name]
    return [f"{name}[{', '.join(map(str, index))}]" for index in np.ndindex(*shape)]


def initial_values(model, point: dict | None = None, argument: str = "point") -> dict[str, np.ndarray]:
    """Values of the free parameters at the model's initial point, unless `point` has others."""
    names = [rv.name for rv in model.free_RVs]
    point = check_mapping(point, argument, "a dict of free parameters to their values")
    if unknown := sorted(set(point) - set(names)):
        raise ValueError(f"`{argument}` must have free parameters only ({', '.join(names)}), got {unknown}.")
    for rv in model.free_RVs:
        if rv.name in point:
            point[rv.name] = value_of(rv, point[rv.name], argument)
    expressions = make_initial_point_expression(
        free_rvs=model.free_RVs,
        rvs_to_transforms={},
        initval_strategies={
            rv: point.get(rv.name, model.rvs_to_initial_values.get(rv)) for rv in model.free_RVs
        },
    )
    values = compile_function([], expressions, mode="FAST_COMPILE")()
    return {name: np.asarray(v, dtype=np.float64) for name, v in zip(names, values, strict=True)}


def posterior_for(model, idata, name: str, advice: str = SAME_MODEL) -> xr.Dataset:
    """The posterior group of a DataTree, with finite draws (chain, draw, ...) of every free parameter."""
    posterior = check_group(idata, name, "posterior", advice, "chain", "draw")
    missing = [rv.name for rv in model.free_RVs if rv.name not in posterior]
    if missing:
        raise ValueError(
            f"`{name}` must hold every free parameter of `model`, got none of {', '.join(missing)}. {advice}"
        )
    for rv in model.free_RVs:
        draws = posterior[rv.name]
        if draws.dims[:2] != ("chain", "draw") or draws.dtype.kind not in "biuf":
            got = f"{rv.name} of type {draws.dtype} along {', '.join(map(str, draws.dims))}"
            raise ValueError(message(name, "draws (chain, draw, ...) of numbers", got, advice))
        check_finite(draws.values, name, f"Those are draws of {rv.name}. {advice}")
    return posterior


def value_of(rv, value, argument: str) -> np.ndarray:
    """A value of a free parameter, of its shape."""
    advice, shape = f"It is the value of {rv.name}.", rv.type.shape
    value = as_numbers(value, argument, advice)
    check_finite(value, argument, advice)
    if value.ndim == 0 and None not in shape:
        value = np.broadcast_to(value, shape)
    if value.ndim != len(shape) or any(
        n not in (None, size) for n, size in zip(shape, value.shape, strict=True)
    ):
        raise ValueError(message(argument, f"of shape {shape}", value.shape, advice))
    return np.array(value)


def forward_transform(model) -> Callable:
    """Compiled function of the free parameters, to a flat point (d,) on the unconstrained scale."""
    rvs = model.free_RVs

    def make():
        inputs = [rv.type() for rv in rvs]
        transforms = [model.rvs_to_transforms[rv] for rv in rvs]
        outputs = [
            rv if transform is None else transform.forward(rv, *rv.owner.inputs)
            for rv, transform in zip(rvs, transforms, strict=True)
        ]
        outputs = graph_replace(outputs, dict(zip(rvs, inputs, strict=True)), strict=False)
        flat = pt.concatenate([x.ravel() for x in outputs])
        return compile_function(inputs, flat, mode="FAST_COMPILE", on_unused_input="ignore")

    return kept_for(model, "forward transform", tuple(map(id, rvs)), make)


def to_unconstrained(model, posterior) -> np.ndarray:
    """Draws of a posterior Dataset (chain, draw, ...), unconstrained and flat: (chain, draw, parameter)."""
    function, rvs = forward_transform(model), model.free_RVs
    columns = [posterior[rv.name].values.astype(rv.dtype) for rv in rvs]
    chains, draws = columns[0].shape[:2]
    with ONE_CALL:
        rows = [[function(*(c[i, j] for c in columns)) for j in range(draws)] for i in range(chains)]
    return np.array(rows)


def some_draws(model, posterior, number: int) -> np.ndarray:
    """About so many unconstrained draws (n, d) of all chains of a posterior, evenly spaced."""
    every = max(1, posterior.sizes["chain"] * posterior.sizes["draw"] // number)
    some = to_unconstrained(model, posterior.isel(draw=slice(None, None, every)))
    return some.reshape(-1, some.shape[-1])


class Unconstrained:
    """Flat points x (d,) on the unconstrained scale, and the variables they stand for.

    Parameters
    ----------
    model : pymc.Model
    """

    def __init__(self, model):
        self.point = model.initial_point()
        self.shapes = {v.name: np.shape(self.point[v.name]) for v in model.value_vars}
        wanted = [*model.free_RVs, *model.deterministics]
        self.names = [v.name for v in wanted]
        self.function = model.compile_fn(
            model.replace_rvs_by_values(wanted), mode="FAST_COMPILE", on_unused_input="ignore"
        )

    def split(self, x) -> dict:
        """Values of the value variables in a flat point, an array or a vector of PyTensor's."""
        values, first = {}, 0
        for name, shape in self.shapes.items():
            size = int(np.prod(shape, dtype=int))
            values[name] = x[first : first + size].reshape(shape)
            first += size
        return values

    def join(self, values) -> np.ndarray:
        """Flat point of a dictionary of value variables."""
        return np.concatenate([np.ravel(values[name]) for name in self.shapes]).astype(np.float64)

    def variables(self, points) -> dict[str, np.ndarray]:
        """Free parameters on their own scale and deterministics, arrays (point, ...)."""
        columns = zip(*(self.function(self.split(x)) for x in points), strict=True)
        return {name: np.stack(column) for name, column in zip(self.names, columns, strict=True)}

    def modes(self, model, points, **more) -> xr.Dataset:
        """Return the values at modes of a posterior, and more that belongs to each, (mode, ...).

        The dimension is posterior_mode where the model has one called mode, as a damping ratio for each mode
        of vibration may well have.
        """
        dims = model.named_vars_to_dims
        over = "posterior_mode" if any("mode" in of_one for of_one in dims.values()) else "mode"
        values = {
            name: ((over, *dims.get(name, [f"{name}_dim_{i}" for i in range(v.ndim - 1)])), v)
            for name, v in self.variables(points).items()
        }
        return xr.Dataset(values | {name: (over, np.asarray(v)) for name, v in more.items()})


def coordinate_names(model, space) -> list[str]:
    """Names of the scalar parameters in the order of the sampled coordinates."""
    shapes = {rv.name: space.shapes[model.rvs_to_values[rv].name] for rv in model.free_RVs}
    return [name for rv, shape in shapes.items() for name in entry_names(rv, shape)]
