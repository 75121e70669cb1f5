"""The prior of a model: draws by a function that is compiled once, and densities outside of its support."""

import uuid
from collections.abc import Callable
from contextlib import suppress
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.transforms import Interval, logodds
from pymc.initial_point import make_initial_point_expression
from pymc.pytensorf import compile as compile_function
from pymc.pytensorf import reseed_rngs
from pymc.vartypes import discrete_types
from pytensor.graph.replace import clone_replace
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorConstant

from pymc_features.smc.density.rows import ONE_CALL

# In this process, and in those forked from it, pickled draws find their compiled function here.
_ALIVE: WeakValueDictionary = WeakValueDictionary()
_OF_MODEL: WeakKeyDictionary = WeakKeyDictionary()


def kept_for(model, name: str, key, make: Callable):
    """What `make` returns, made for a model once under each name, and anew where the key is another."""
    kept = _OF_MODEL.setdefault(model, {})
    if name not in kept or kept[name][0] != key:
        kept[name] = key, make()
    return kept[name][1]


class PriorDraws:
    """First particles: for the same generator the same numbers as PyMC's kernels draw.

    Parameters
    ----------
    expressions : dict of TensorVariable
        One draw of each value variable by its name, on the unconstrained scale.
    """

    def __init__(self, expressions: dict):
        self.token, self.expressions = uuid.uuid4().hex, expressions
        self._compile()
        _ALIVE[self.token] = self

    def _compile(self):
        # the seed comes with each call
        outputs = list(self.expressions.values())
        self.function, updates = compile_function([], outputs, random_seed=False, return_updates=True)
        self.rngs = list(updates)
        self.function()  # in this process, that forked ones need not begin with the machine code

    def __call__(self, draws: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return an array (draws, ...) of each value variable, by its name."""
        with ONE_CALL:
            reseed_rngs(self.rngs, rng.integers(2**30, dtype=np.int64))
            drawn = [self.function() for _ in range(draws)]
        columns = map(np.stack, zip(*drawn, strict=True))
        return dict(zip(self.expressions, columns, strict=True))

    def __getstate__(self):
        return {"token": self.token, "expressions": self.expressions}

    def __setstate__(self, state):
        self.__dict__.update(state)
        alive = _ALIVE.get(self.token)
        if alive is None:
            self._compile()
        else:
            self.function, self.rngs = alive.function, alive.rngs


def prior_draws(model, ignore_initial_values: bool) -> PriorDraws:
    """Draws of the model's free variables, compiled the first time they are asked for.

    Parameters
    ----------
    model : pymc.Model
    ignore_initial_values : bool
        PyMC starts every particle of a variable with an `initval` there. If true, it is drawn, too.
    """
    initial_values = {
        rv: None if ignore_initial_values else value for rv, value in model.rvs_to_initial_values.items()
    }
    key = tuple((id(rv), id(model.rvs_to_values[rv]), id(initial_values[rv])) for rv in model.free_RVs)

    def make():
        expressions = make_initial_point_expression(
            free_rvs=model.free_RVs,
            rvs_to_transforms=model.rvs_to_transforms,
            initval_strategies=initial_values,
            default_strategy="prior",
            return_transformed=True,
        )
        names = [model.rvs_to_values[rv].name for rv in model.free_RVs]
        return PriorDraws(dict(zip(names, expressions, strict=True)))

    return kept_for(model, "draws", key, make)


def prior_points(model, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draws from the prior (n, d) on the sampled scale, in the order of the model's value variables."""
    columns = prior_draws(model, True)(n, rng)
    return np.hstack([np.reshape(columns[v.name], (n, -1)) for v in model.value_vars])


def are_logits(model) -> list[bool]:
    """Whether each value variable is the logit of a parameter between two bounds."""
    flags = []
    for value in model.value_vars:
        rv = model.values_to_rvs[value]
        transform = model.rvs_to_transforms[rv]
        interval = isinstance(transform, Interval)
        bounded = interval and None not in transform.args_fn(*rv.owner.inputs)
        flags.append(bounded or isinstance(transform, type(logodds)))
    return flags


def inside_support(model, point, terms) -> tuple[list, list]:
    """The terms, with -inf for the prior outside of its support, and what they depend on instead.

    Discrete variables move on the real line and are rounded. They and others without a transform may be
    proposed where their prior is zero, and what comes after may have no value there: an index leads to no
    place. There, the rest is evaluated at a draw from the prior.
    """
    inputs, values, inside, possible = {v: v for v in model.value_vars}, {}, [], {}
    for rv in model.free_RVs:  # parents come before those that depend on them
        v = model.rvs_to_values[rv]
        is_discrete = v.dtype in discrete_types
        if not is_discrete and model.rvs_to_transforms[rv] is not None:
            continue
        [own] = model.logp(vars=[rv], sum=False)
        if not (is_discrete or has_edges(own)):
            continue
        possible = possible or possible_values(model, point)
        inputs[v] = pt.tensor(v.name, dtype="floatX" if is_discrete else v.dtype, shape=v.type.shape)
        value = pt.round(inputs[v]).astype(v.dtype) if is_discrete else inputs[v]
        allowed = pt.neq(clone_replace(own, values | {v: value}, rebuild_strict=False), -np.inf)
        inside.append(allowed.all())
        allowed = pt.shape_padright(allowed, v.ndim - allowed.ndim)
        values[v] = pt.switch(allowed, value, possible[v.name].astype(v.dtype)).astype(v.dtype)
    if inside:
        prior, *rest = clone_replace(list(terms), values, rebuild_strict=False)
        terms = [pt.switch(pt.all(inside), prior, -np.inf), *rest]
    return list(terms), list(inputs.values())


def has_edges(logp) -> bool:
    """Whether a log-density is -inf somewhere, by a constant in its graph."""
    constants = [v.data for v in ancestors([logp]) if isinstance(v, TensorConstant)]
    return any(np.isneginf(c).any() for c in constants)


def possible_values(model, point) -> dict[str, np.ndarray]:
    """One draw from the prior; the given `point` where there are no draws."""
    with suppress(NotImplementedError):
        drawn = prior_draws(model, True)(1, np.random.default_rng(0))
        return {name: values[0] for name, values in drawn.items()}
    return {name: np.asarray(value) for name, value in point.items()}
