"""The specimen of a cyclic test, a hysteretic spring at a given displacement, and what cycles do to it."""

from dataclasses import KW_ONLY
from typing import Annotated, NoReturn

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable

from pymc_features.records import DynamicLoad
from pymc_features.structures.base import (
    AT_LEAST_ONE,
    FINITE,
    NOT_NEGATIVE,
    NUMERIC,
    POSITIVE,
    SHARE,
    Described,
    Input,
    Kind,
    Structure,
    described,
    is_numeric,
    scalar,
)
from pymc_features.structures.chains import SHARPNESS

type Value = float | Variable

LEFT_OUT = "Leave it out for none."
NO_MASS = (
    "`structure` must have masses for this, got a HystereticSpecimen. It has a force under a prescribed "
    "displacement, and neither matrices nor modes."
)


class Deterioration(Described):
    """Base: numbers or variables by name, in the order of the kernels."""

    def values(self) -> list[Value]:
        """The parameters, in their order."""
        return [getattr(self, name) for name in self.inputs]

    def __repr__(self):
        listed = ", ".join(f"{name}={getattr(self, name)}" for name in self.inputs)
        return f"{type(self).__name__}({listed})"


@described
class Degradation(Deterioration):
    """Degradation of strength and stiffness with the energy that a spring has dissipated.

    With the dimensionless energy e = (integral of z dd) / d_y: the strength falls as nu^(-1/n), the stiffness
    of the hysteretic part as 1 / eta::

        nu = 1 + delta_nu e,    eta = 1 + delta_eta e.

    Parameters
    ----------
    strength : float or TensorVariable
        delta_nu [-], not negative.
    stiffness : float or TensorVariable
        delta_eta [-], not negative.

    References
    ----------
    T. T. Baber & Y.-K. Wen, J. Eng. Mech. Div. ASCE 107 (1981) 1069-1087.
    """

    strength: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)] = 0.0
    stiffness: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)] = 0.0


@described
class Pinching(Deterioration):
    """Pinching of loops: near a small force the spring slips, more so the more energy it has dissipated.

    The slope of z is multiplied by h; z_u is the largest value of z, e as of `Degradation`::

        h = 1 - zeta_1 exp{-[z sign(d') - q z_u]^2 / zeta_2^2},
        zeta_1 = zeta_s (1 - exp(-p e)),    zeta_2 = (psi + delta_psi e) (lambda + zeta_1).

    Parameters
    ----------
    slip : float or TensorVariable
        zeta_s [-], from 0 to below 1: by how much the slope falls in the end.
    rate : float or TensorVariable
        p [-], not negative: how fast it falls with the energy.
    initiation : float or TensorVariable
        q [-], not negative: the part of z_u at which the slope is least.
    spread : float or TensorVariable
        psi [-], positive: over how much of z the pinch extends.
    spread_rate : float or TensorVariable
        delta_psi [-], not negative: how fast that grows with the energy.
    severity : float or TensorVariable
        lambda [-], positive: how much of the extent is there before any slip.

    References
    ----------
    T. T. Baber & M. N. Noori, J. Vib. Acoust. 108 (1986) 411-420. G. C. Foliente, J. Struct. Eng. 121 (1995)
    1013-1022, with these functions.
    """

    slip: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)]
    rate: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)] = 1.0
    _: KW_ONLY
    initiation: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)] = 0.1
    spread: Annotated[Value, scalar("-", POSITIVE, NUMERIC)] = 0.2
    spread_rate: Annotated[Value, scalar("-", NOT_NEGATIVE, NUMERIC)] = 0.0
    severity: Annotated[Value, scalar("-", POSITIVE, NUMERIC)] = 0.3

    def __post_init__(self):
        super().__post_init__()
        if is_numeric(self.slip) and self.slip >= 1.0:
            raise ValueError(
                f"`slip` must be below 1, got {self.slip:g}. With 1 a spring would slip without force."
            )


@described
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
    >>> from pymc_features import simulate
    >>> from pymc_features.records import CyclicTest
    >>> specimen = HystereticSpecimen(2e6, yield_displacement=0.01, post_yield_ratio=0.0, sharpness=1.0)
    >>> force = simulate(specimen, CyclicTest([0.0, 0.01, 0.02]))
    >>> (force.values[0] / 2e4).round(6)  # 1 - exp(-d / d_y)
    array([0.      , 0.632121, 0.864665])
    """

    stiffness: Annotated[Value, scalar("N/m")]
    _: KW_ONLY
    yield_displacement: Annotated[Value, scalar("m")]
    post_yield_ratio: Annotated[Value, scalar("-", SHARE, "Pass post-yield over initial stiffness.")]
    sharpness: Annotated[Value, scalar("-", AT_LEAST_ONE, SHARPNESS)] = 2.0
    beta: Annotated[Value, scalar("-", POSITIVE, NUMERIC)] = 0.5
    gamma: Annotated[Value, scalar("-", FINITE, NUMERIC)] = 0.5
    degradation: Annotated[Degradation | None, Input(Kind.DEGRADATION, advice=LEFT_OUT)] = None
    pinching: Annotated[Pinching | None, Input(Kind.PINCHING, advice=LEFT_OUT)] = None

    family = "specimen"
    is_linear = False

    def __post_init__(self):
        super().__post_init__()
        self.degradation = self.degradation or Degradation()
        self.pinching = self.pinching or Pinching(0.0)
        if is_numeric(self.beta) and is_numeric(self.gamma) and not -self.beta < self.gamma <= self.beta:
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
        *loops, _, _ = (getattr(self, name) for name in self.inputs)
        values = [*loops, *self.degradation.values(), *self.pinching.values()]
        if all(map(is_numeric, values)):
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
        return record.inputs[0]

    def matrices(self) -> NoReturn:
        raise TypeError(NO_MASS)

    def modes(self, n_modes: int | None = None) -> NoReturn:
        raise TypeError(NO_MASS)

    def inertia(self) -> NoReturn:
        raise TypeError(NO_MASS)


SPECIMENS = (HystereticSpecimen,)
DETERIORATIONS = (Degradation, Pinching)
