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


class Coordinates(NamedTuple):
    """How points w (..., d) stand for unconstrained ones z (..., d)."""

    sides: np.ndarray  # bounds (d,) of each parameter: 0, 1 or 2
    near: np.ndarray  # whether it is measured from a bound (d,)
    origin: np.ndarray  # z (d,) where the distance from an only bound is one: of the model's initial point

    @classmethod
    def plain(cls, sides, origin) -> "Coordinates":
        """Unconstrained parameters."""
        return cls(sides, np.zeros(len(sides), dtype=bool), origin)

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
        """Derivatives of the coordinates by z."""
        return np.where(self.near, self.own_slopes(z), 1.0)

    @property
    def limits(self) -> np.ndarray:
        """Lowest and highest coordinates (2, d)."""
        high = np.where(self.sides == 2, 1.0 - EDGE, np.inf)
        return np.where(self.near, [np.full(len(high), EDGE), high], [[-np.inf], [np.inf]])


def sides_of(model, space) -> np.ndarray:
    """Bounds (d,) of each parameter: 0, 1 or 2, in the order of the model's value variables."""
    found = []
    for rv in model.free_RVs:
        transform, shape = model.rvs_to_transforms[rv], space.shapes[model.rvs_to_values[rv].name]
        sides = {transforms.log: 1, transforms.logodds: 2}.get(transform, 0)
        if isinstance(transform, transforms.Interval):
            ends = [pt.as_tensor(x) for x in transform.args_fn(*rv.owner.inputs) if x is not None]
            compiled = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}
            ends = model.compile_fn(model.replace_rvs_by_values(ends), inputs=model.value_vars, **compiled)
            sides = sum(np.isfinite(x).astype(int) for x in ends(space.point))
        found.append(np.broadcast_to(sides, shape).ravel())
    return np.concatenate(found)
