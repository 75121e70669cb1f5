"""Coordinates of climbs: unconstrained parameters, but near a bound of the prior the distance to it.

On the scale that PyMC samples a bound is at infinity, and so is the maximum of a likelihood that wants a
parameter beyond it. Such a parameter is measured by w = expit(z) between two bounds, from the lower one and
over the distance between them, and by w = exp(z - origin) from its only bound.
"""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.distributions import transforms
from scipy.special import expit, logit

EDGE = 1e-9  # of these distances: as near to a bound as a climb gets
LARGEST = 700.0  # logarithm of a number
BEYOND = 800.0  # unconstrained, so far out that the bound itself is what is meant


class Coordinates(NamedTuple):
    """How points w (d,) stand for unconstrained ones z (d,).

    Attributes
    ----------
    sides : int array (d,)
        Bounds of each parameter: 0, 1 or 2.
    near : bool array (d,)
        Whether it is measured from a bound.
    origin : array (d,)
        z where the distance from an only bound is one: of the model's initial point.
    """

    sides: np.ndarray
    near: np.ndarray
    origin: np.ndarray

    @classmethod
    def plain(cls, sides, origin) -> "Coordinates":
        """Unconstrained parameters."""
        return cls(sides, np.zeros(len(sides), dtype=bool), origin)

    def measured_from_bounds(self, near) -> "Coordinates":
        """Those where some parameters (d,), of those that have one, are measured from a bound."""
        return self._replace(near=near & (self.sides > 0))

    def of(self, z) -> np.ndarray:
        """Coordinates of an unconstrained point."""
        return np.where(self.near, self.distance(z), z)

    def unconstrained(self, w) -> np.ndarray:
        """The unconstrained point of coordinates."""
        inside = np.where(self.near, w, 0.5)
        return np.where(self.near, np.where(self.sides == 2, logit(inside), np.log(inside) + self.origin), w)

    def distance(self, z) -> np.ndarray:
        """From the lower or only bound, of every parameter that has one."""
        one = np.where(self.sides == 1, np.minimum(z - self.origin, LARGEST), 0.0)
        return np.where(self.sides == 2, expit(z), np.exp(one))

    def own_slopes(self, z) -> np.ndarray:
        """Derivatives of these distances by z."""
        w = self.distance(z)
        return np.where(self.sides == 2, w * expit(-z), w)

    def slopes(self, z) -> np.ndarray:
        """Derivatives (d,) of the coordinates by z."""
        return np.where(self.near, self.own_slopes(z), 1.0)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates."""
        high = np.where(self.sides == 2, 1.0 - EDGE, np.inf)
        return np.where(self.near, EDGE, -np.inf), np.where(self.near, high, np.inf)

    def rooms(self, z, sd) -> np.ndarray:
        """Standard deviations (2, d) to the lower or only bound, and to the upper; `sd` of coordinates."""
        sd = sd * self.own_slopes(z) / self.slopes(z)
        low = np.where(self.sides > 0, self.distance(z) / sd, np.inf)
        return np.array([low, np.where(self.sides == 2, expit(-z) / sd, np.inf)])


def sides_of(model) -> np.ndarray:
    """Bounds (d,) of each parameter: 0, 1 or 2, in the order of the model's value variables."""
    point, found = model.initial_point(), []
    for rv in model.free_RVs:
        transform, shape = model.rvs_to_transforms[rv], np.shape(point[model.rvs_to_values[rv].name])
        sides = {transforms.log: 1, transforms.logodds: 2}.get(transform, 0)
        if isinstance(transform, transforms.Interval):
            ends = [pt.as_tensor(x) for x in transform.args_fn(*rv.owner.inputs) if x is not None]
            ends = model.replace_rvs_by_values(ends)
            compiled = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}
            values = model.compile_fn(ends, inputs=model.value_vars, **compiled)(point)
            sides = sum(np.isfinite(x).astype(int) for x in values)
        found.append(np.broadcast_to(sides, shape).ravel())
    return np.concatenate(found)
