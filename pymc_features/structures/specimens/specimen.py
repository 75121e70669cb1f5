"""The specimen of a cyclic test: one hysteretic spring whose displacement is prescribed."""

from typing import NoReturn

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable

from pymc_features._checks import check_number, is_number, single
from pymc_features.records import DynamicLoad
from pymc_features.structures.base import Structure
from pymc_features.structures.inputs import DEGRADATION, PINCHING, scalar
from pymc_features.structures.specimens.deterioration import (
    NO_DEGRADATION,
    NO_PINCHING,
    Degradation,
    Pinching,
    Value,
    scalar_of,
)
from pymc_features.structures.variables import as_float_tensor, unpacked


class HystereticSpecimen(Structure):
    """A Bouc-Wen spring that degrades and is pinched, under a prescribed displacement.

    The law of Bouc, Wen, Baber and Noori. With the displacement d and a dimensionless internal variable z,
    at rest zero::

        f = a k d + (1 - a) k d_y z,
        d_y z' = d' h {1 - nu |z|^n [gamma + beta sign(d' z)]} / eta,

    with nu and eta of `Degradation`, and h of `Pinching`. They are functions of the energy that the
    hysteretic part has taken up, (1 - a) k d_y^2 e [J], d_y e' = z d'. Time plays no part in it.

    Parameters
    ----------
    stiffness : float or TensorVariable
        k [N/m], the initial one, positive.
    yield_displacement : float or TensorVariable
        d_y [m], positive: where the initial and the post-yield line meet if beta + gamma = 1.
    post_yield_ratio : float or TensorVariable
        a [-], from 0 to 1: stiffness long after yielding over the initial one.
    sharpness : float or TensorVariable
        n [-], at least 1: how sudden yielding is.
    beta, gamma : float or TensorVariable
        Shape of the loops [-], beta > 0 and -beta < gamma <= beta. ``|z|`` stays below
        (beta + gamma)^(-1/n); leave the sum at one unless published values say otherwise, for d_y scales
        with it. With beta = gamma the spring unloads at its initial stiffness.
    degradation : Degradation, optional
        Of strength and stiffness; none by default.
    pinching : Pinching, optional
        None by default: without both the law is that of the springs of `HystereticChain`.

    Raises
    ------
    ValueError, TypeError
        If a number is out of its range.

    Notes
    -----
    Numbers are checked here; variables cannot be. Where a draw leaves the ranges, the response is NaN.

    Integrated along the displacement, exactly turned at its reversals, by a fifth-order method with control
    of its error: to 1e-7 of the peak, mostly 1e-9, with strong degradation and pinching too
    (tests/simulators/test_cyclic.py). A force costs about 3 microseconds for each given displacement, and
    with its derivatives by all parameters three times as much.

    The law dissipates in every part of a cycle for gamma <= beta where it neither loses stiffness nor is
    pinched. With n <= 2 and beta + gamma >= 1 it may lose stiffness by delta_eta <= 2 (beta + gamma) (the
    test shows it, with the free energy (1 - a) k d_y^2 eta z^2 / 2 + a k d^2 / 2). Pinched springs may
    give energy back when they are unloaded.

    Published values of delta_nu, delta_eta, p and delta_psi are often for an energy per mass, or for a z
    that is a displacement: multiply them by that energy over e.

    References
    ----------
    T. T. Baber & M. N. Noori, J. Eng. Mech. 111 (1985) 1010-1026; J. Vib. Acoust. 108 (1986) 411-420.
    G. C. Foliente, J. Struct. Eng. 121 (1995) 1013-1022. F. Ma et al., J. Appl. Mech. 71 (2004) 342-349: A is
    left out, for no data can tell it from the other parameters. S. Erlicher & N. Point, C. R. Mecanique 332
    (2004) 51-57: ``beta >= |gamma|``.

    Examples
    --------
    >>> from pymc_features import CyclicTest, simulate
    >>> specimen = HystereticSpecimen(2e6, yield_displacement=0.01, post_yield_ratio=0.0, sharpness=1.0)
    >>> force = simulate(specimen, CyclicTest([0.0, 0.01, 0.02]))
    >>> (force.values[0] / 2e4).round(6)  # 1 - exp(-d / d_y)
    array([0.      , 0.632121, 0.864665])
    """

    family = "specimen"
    is_linear = False
    inputs = {
        "stiffness": scalar("N/m"),
        "yield_displacement": scalar("m"),
        "post_yield_ratio": scalar("-"),
        "sharpness": scalar("-"),
        "beta": scalar("-"),
        "gamma": scalar("-"),
        "degradation": DEGRADATION,
        "pinching": PINCHING,
    }

    def __init__(
        self,
        stiffness: Value,
        *,
        yield_displacement: Value,
        post_yield_ratio: Value,
        sharpness: Value = 2.0,
        beta: Value = 0.5,
        gamma: Value = 0.5,
        degradation: Degradation | None = None,
        pinching: Pinching | None = None,
    ):
        self.stiffness = scalar_of(stiffness, "stiffness", "N/m")
        self.yield_displacement = scalar_of(yield_displacement, "yield_displacement", "m")
        unit = "fractions of the initial stiffness"
        self.post_yield_ratio = scalar_of(post_yield_ratio, "post_yield_ratio", unit, allow_zero=True)
        self.sharpness = scalar_of(sharpness, "sharpness", "plain numbers, 1 or more")
        self.beta = scalar_of(beta, "beta", "plain numbers")
        self.gamma = of_any_sign(gamma, "gamma")
        for name, value, kind in (
            ("degradation", degradation, Degradation),
            ("pinching", pinching, Pinching),
        ):
            if not isinstance(value, kind | None):
                raise TypeError(
                    f"`{name}` must be a {kind.__name__}, got {type(value).__name__}. Leave it out for none."
                )
        self.degradation = NO_DEGRADATION if degradation is None else degradation
        self.pinching = NO_PINCHING if pinching is None else pinching
        self._check_ranges()

    def _check_ranges(self):
        if known(self.post_yield_ratio) and self.post_yield_ratio > 1.0:
            raise ValueError(
                f"`post_yield_ratio` must lie between 0 and 1, got {self.post_yield_ratio:g}. Pass "
                "post-yield over initial stiffness."
            )
        if known(self.sharpness) and self.sharpness < 1.0:
            raise ValueError(
                f"`sharpness` must be at least 1, got {self.sharpness:g}. Pass 1 to 3 for gradual yielding."
            )
        if known(self.beta) and known(self.gamma) and not -self.beta < self.gamma <= self.beta:
            raise ValueError(
                f"`gamma` must lie above -beta and not exceed beta = {self.beta:g}, got {self.gamma:g}. "
                "Loops would produce energy, or have no strength; `beta` goes with sign(d' z)."
            )

    def __repr__(self):
        return f"HystereticSpecimen({self.degradation!r}, {self.pinching!r})"

    @property
    def n_dof(self) -> int:
        return 1

    def parameters(self) -> tuple:
        """All fourteen as one vector, in the order of the kernels."""
        spring = self.stiffness, self.yield_displacement, self.post_yield_ratio
        loops = self.sharpness, self.beta, self.gamma
        values = [*spring, *loops, *self.degradation.values(), *self.pinching.values()]
        if all(map(known, values)):
            return (np.array(values),)
        return (pt.stack([pt.as_tensor_variable(value, dtype="float64") for value in values]),)

    def check_load(self, record: DynamicLoad) -> None:
        """Refuse what is no prescribed displacement."""
        if not record.is_displacement:
            raise TypeError(
                f"`record` must be a CyclicTest for a HystereticSpecimen, got {type(record).__name__}. A "
                "specimen has no mass: use `HystereticChain` for one that is shaken."
            )

    def excitation(self, record: DynamicLoad) -> np.ndarray:
        """Return the displacement (time,) [m]."""
        self.check_load(record)
        return record.inputs[0]

    def matrices(self) -> NoReturn:
        raise TypeError(NO_MASS)

    def modes(self, n_modes: int | None = None) -> NoReturn:
        raise TypeError(NO_MASS)

    def inertia(self) -> NoReturn:
        raise TypeError(NO_MASS)


NO_MASS = (
    "`structure` must have masses for this, got a HystereticSpecimen. It has a force under a prescribed "
    "displacement, and neither matrices nor modes."
)


def of_any_sign(value, name: str) -> Value:
    """Return a checked finite float, or a scalar tensor."""
    if is_number(single(value)):
        number = check_number(value, name)
        if not np.isfinite(number):
            raise ValueError(f"`{name}` must be finite, got {number:g}.")
        return number
    value = unpacked(value)
    tensor = as_float_tensor(value, name) if isinstance(value, Variable) else None
    if tensor is not None and not tensor.ndim:
        return tensor
    return scalar_of(value, name, "plain numbers", allow_zero=True)


def known(value) -> bool:
    """Whether a parameter is a number."""
    return not isinstance(value, Variable)
