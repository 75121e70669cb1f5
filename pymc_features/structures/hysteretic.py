"""The chain with hysteretic springs: Bouc-Wen, and elastic-plastic as its limit."""

import numpy as np
from pytensor.graph.basic import Variable

from pymc_features.structures.base import Values
from pymc_features.structures.damping import Damping
from pymc_features.structures.inputs import vector
from pymc_features.structures.masses_and_springs import Chain


class HystereticChain(Chain):
    """A spring-mass chain with Bouc-Wen springs.

    With the drift d of a spring and a dimensionless internal variable z, at rest zero::

        f = a k d + (1 - a) k d_y z,    d_y z' = d' [1 - |z|^n (gamma + beta sign(d' z))].

    Parameters
    ----------
    mass, stiffness, damping
        As of `SpringMassChain`; `stiffness` is the initial one, k, and damping is formed with it.
    yield_displacement : float, array_like (n,) or TensorVariable
        d_y [m], positive: the drift at which the initial and the post-yield line meet if beta + gamma = 1.
        One value stands for all springs, here and below.
    post_yield_ratio : float, array_like (n,) or TensorVariable
        a [-], from 0 to 1: stiffness long after yielding over the initial one. With 1 the chain is linear.
    sharpness : float, array_like (n,) or TensorVariable
        n [-], at least 1: how sudden yielding is. Bilinear (elastic-plastic with hardening) in the limit of
        large n; with 20 the force at d_y is 3 % below the bilinear one.
    beta, gamma : float, array_like (n,) or TensorVariable
        Shape of the loops [-], beta > 0 and 0 <= gamma <= beta, for then every loop dissipates energy.
        ``|z|`` stays below (beta + gamma)^(-1/n); leave the sum at one unless published values say otherwise.
        With beta = gamma springs unload at the initial stiffness.

    Raises
    ------
    ValueError, TypeError
        If a number is out of its range or lengths differ.

    Notes
    -----
    Numbers are checked here; variables cannot be. Where a draw leaves the ranges, the response is NaN.

    Histories are integrated by a fifth-order method in steps that follow the state and end at the kinks of
    the law: to 1e-6 of the peak, mostly 1e-8 (tests/simulators/test_hysteretic.py; `integration_error`
    estimates it). Without damping errors of phase add up, to 1e-6 after a dozen periods. One response of ten
    storeys under a record at 0.02 s costs about 0.5 microseconds for each spring and step with n = 1 or 2, 1
    with another n; more where the highest period is shorter than five steps.

    Mean squares with n up to 6 are integrated by Taylor steps: they agree with those of histories to some
    1e-7, at worst to some 1e-6 (tests/simulators/test_taylor.py). Their gradients are the exact derivatives,
    at the price of three to six values. With n = 1 or 2 that costs a third to a half of what it does with
    another n. Gradients of histories, and with n above 6, are central differences: two responses for each
    number that is no constant.

    References
    ----------
    Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249-263. S. Erlicher & N. Point, C. R. Mecanique 332 (2004)
    51-57: ``beta >= |gamma|`` for a law that dissipates.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> damping = ModalDamping(0.02)
    >>> chain = HystereticChain([1.0, 1.0], 100.0, damping, yield_displacement=0.01, post_yield_ratio=0.1)
    >>> chain
    HystereticChain(2 masses, ModalDamping(0.02))
    """

    family = "hysteretic"
    is_linear = False
    inputs = Chain.inputs | {
        "yield_displacement": vector("m"),
        "post_yield_ratio": vector("-"),
        "sharpness": vector("-"),
        "beta": vector("-"),
        "gamma": vector("-"),
    }

    def __init__(
        self,
        mass: Values,
        stiffness: Values,
        damping: Damping,
        *,
        yield_displacement: Values,
        post_yield_ratio: Values,
        sharpness: Values = 2.0,
        beta: Values = 0.5,
        gamma: Values = 0.5,
    ):
        super().__init__(mass, stiffness, damping)
        self.yield_displacement = self.spring_vector(yield_displacement, "yield_displacement", "m")
        self.post_yield_ratio = self.spring_vector(
            post_yield_ratio, "post_yield_ratio", "fractions of the initial stiffness", allow_zero=True
        )
        self.sharpness = self.spring_vector(sharpness, "sharpness", "plain numbers, 1 or more")
        self.beta = self.spring_vector(beta, "beta", "plain numbers")
        self.gamma = self.spring_vector(gamma, "gamma", "plain numbers", allow_zero=True)
        self._check_ranges()

    def _check_ranges(self):
        if known(self.post_yield_ratio) and self.post_yield_ratio.max() > 1.0:
            raise ValueError(
                f"`post_yield_ratio` must lie between 0 and 1, got {self.post_yield_ratio.max():g}. "
                "Pass post-yield over initial stiffness; use `DuffingChain` for springs that harden."
            )
        if known(self.sharpness) and self.sharpness.min() < 1.0:
            raise ValueError(
                f"`sharpness` must be at least 1, got {self.sharpness.min():g}. "
                "Pass 1 to 3 for gradual yielding, 20 or more for a nearly bilinear spring."
            )
        if known(self.beta) and known(self.gamma) and (self.gamma > self.beta).any():
            beta, gamma = np.broadcast_arrays(self.beta, self.gamma)
            wrong = np.flatnonzero(np.atleast_1d(gamma > beta))[0]
            raise ValueError(
                f"`gamma` must not exceed `beta`, got {gamma.flat[wrong]:g} and {beta.flat[wrong]:g}. "
                "Loops would produce energy; in this notation `beta` goes with sign(d' z)."
            )

    def parameters(self) -> tuple:
        rows = (self.yield_displacement, self.post_yield_ratio, self.sharpness, self.beta, self.gamma)
        return *self.linear_parameters(), self.spring_table(*rows)


def known(value):
    """Whether a parameter is numbers."""
    return not isinstance(value, Variable)
