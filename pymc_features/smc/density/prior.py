"""Draws from the prior of a model, from a function that is compiled once."""

import uuid
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
from pymc.distributions.transforms import Interval, logodds
from pymc.initial_point import make_initial_point_expression
from pymc.pytensorf import compile as compile_function
from pymc.pytensorf import reseed_rngs

from pymc_features.smc.density.rows import ONE_CALL

# In this process, and in those forked from it, pickled draws find their compiled function here.
_ALIVE: WeakValueDictionary = WeakValueDictionary()
_OF_MODEL: WeakKeyDictionary = WeakKeyDictionary()


class PriorDraws:
    """First particles: for the same generator the same numbers as PyMC's kernels draw.

    Parameters
    ----------
    expression : list of TensorVariable
        One draw of each variable, on the unconstrained scale.
    """

    def __init__(self, expression: list):
        self.token = uuid.uuid4().hex
        self.expression = expression
        self._compile()
        _ALIVE[self.token] = self

    def _compile(self):
        # the seed comes with each call
        self.function, updates = compile_function([], self.expression, random_seed=False, return_updates=True)
        self.rngs = list(updates)
        self.function()  # in this process, that forked ones need not begin with the machine code

    def __call__(self, draws: int, rng: np.random.Generator) -> list[np.ndarray]:
        """Return an array (draws, ...) for each variable."""
        with ONE_CALL:
            reseed_rngs(self.rngs, rng.integers(2**30, dtype=np.int64))
            drawn = [self.function() for _ in range(draws)]
        return [np.stack(column) for column in zip(*drawn, strict=True)]

    def __getstate__(self):
        return {"token": self.token, "expression": self.expression}

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
    known = _OF_MODEL.get(model)
    if known is None or known[0] != key:
        expression = make_initial_point_expression(
            free_rvs=model.free_RVs,
            rvs_to_transforms=model.rvs_to_transforms,
            initval_strategies=initial_values,
            default_strategy="prior",
            return_transformed=True,
        )
        known = _OF_MODEL[model] = (key, PriorDraws(expression))
    return known[1]


def prior_points(model, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draws from the prior (n, d) on the sampled scale, in the order of the model's value variables."""
    names = [model.rvs_to_values[rv].name for rv in model.free_RVs]
    columns = dict(zip(names, prior_draws(model, True)(n, rng), strict=True))
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
