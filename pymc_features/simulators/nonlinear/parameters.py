"""The parameters of a chain of nonlinear springs."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.law import LAWS


class NonlinearParameters(NamedTuple):
    """Masses on nonlinear springs in a row; of a population each array has one more axis in front.

    Attributes
    ----------
    mass, stiffness, rayleigh, ratios : array (n,), (n,), (2,), (n,)
        As of `ChainParameters`, with the springs' initial stiffnesses.
    law : array (rows, n)
        Parameters of the law of each spring.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray
    law: np.ndarray


@jit
def particle(parameters, k):
    """Parameters of particle `k` of a population, each with a row for it or one for all."""
    mass, stiffness, rayleigh, ratios, values = parameters
    return NonlinearParameters(
        mass[k % mass.shape[0]],
        stiffness[k % stiffness.shape[0]],
        rayleigh[k % rayleigh.shape[0]],
        ratios[k % ratios.shape[0]],
        values[k % values.shape[0]],
    )


def n_particles(parameters) -> int:
    """Number of particles of a population."""
    sizes = {len(p) for p in parameters}
    if len(sizes - {1}) > 1:
        raise ValueError(
            f"all parameters must have one row, or one for each particle, got {sorted(sizes)} rows."
        )
    return max(sizes)


def check_parameters(law, parameters, wanted):
    """Refuse parameters and outputs whose sizes would make a kernel read outside its arrays."""
    n, sensors = parameters.mass.shape[-1], wanted.sensors
    expected = NonlinearParameters((n,), (n,), (2,), (n,), (LAWS[law].n_parameters, n))
    for name, values, shape in zip(parameters._fields, parameters, expected, strict=True):
        if values.shape[-len(shape) :] != shape:
            raise ValueError(f"`{name}` must have the shape {shape} of {n} springs, got {values.shape}.")
    if wanted.n_modes != n:
        raise ValueError(f"`n_modes` must be all {n} of a nonlinear chain, got {wanted.n_modes}.")
    if sensors.size and (sensors.min() < 0 or sensors.max() >= n):
        raise ValueError(f"`sensors` must be degrees of freedom from 0 to {n - 1}, got {sensors.tolist()}.")


def check_history(history, expected) -> np.ndarray:
    """Return data or a cotangent of the response, if it has its shape."""
    if history.shape != expected:
        raise ValueError(
            "`observed`, or the cotangent, must have the shape (sensor, time) of the response, "
            f"{expected}, got {history.shape}."
        )
    return history
