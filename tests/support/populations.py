"""Models without a structure, and particles of any model, for what is evaluated for a whole population."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt

from pymc_features.sampling import PopulationIMH


def discrete():
    """A count beside a real number."""
    with pm.Model() as model:
        k = pm.Poisson("k", 3.0)
        x = pm.Normal("x")
        pm.Normal("y", k + x, 0.5, observed=4.0)
    return model


def potential():
    """A ring as a term of its own, and data."""
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Potential("ring", -((pt.sum(x**2) - 2.0) ** 2))
        pm.Normal("y", x[0], 0.5, observed=1.0)
    return model


def prior_particles(model, n=40, spread=1.0, seed=0):
    """Draws from the prior, moved about, (n, d)."""
    particles = PopulationIMH(n, model=model, random_seed=seed).initial_particles(n)
    return particles + spread * np.random.default_rng(seed).normal(size=particles.shape)


def points_of(model, particles):
    """The same particles as PyMC's points; counts are rounded."""
    shapes = {name: np.shape(value) for name, value in model.initial_point().items()}
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])[:-1]
    points = []
    for row in particles:
        parts = zip(shapes.items(), np.split(row, ends), strict=True)
        point = {name: part.reshape(shape) for (name, shape), part in parts}
        for v in model.value_vars:
            if v.dtype.startswith("int"):
                point[v.name] = np.round(point[v.name]).astype(v.dtype)
        points.append(point)
    return points
