"""The parameters of a spring-mass chain."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit


class ChainParameters(NamedTuple):
    """Masses on springs in a row, with Rayleigh damping and damping ratios added to it.

    Of a population each array has one more axis in front: a row for each particle, or one for all.

    Attributes
    ----------
    mass, stiffness : array (n,)
        Masses [kg] and springs [N/m], both from the base upwards.
    rayleigh : array (2,)
        alpha [1/s] and beta [s].
    ratios : array (n,)
        Damping ratios [-] of the modes, lowest first.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray


@jit
def own_rows(parameters, p):
    """Row p of each parameter of a population; one row stands for all."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        mass[p % mass.shape[0]],
        stiffness[p % stiffness.shape[0]],
        rayleigh[p % rayleigh.shape[0]],
        ratios[p % ratios.shape[0]],
    )


@jit
def zeros_like(parameters):
    """Gradients of the shapes of the parameters, zero."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        np.zeros(mass.shape), np.zeros(stiffness.shape), np.zeros(rayleigh.shape), np.zeros(ratios.shape)
    )
