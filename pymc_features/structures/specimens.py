"""The specimen of a cyclic test, a hysteretic spring at a given displacement, and what cycles do to it."""

from typing import NoReturn

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable

from pymc_features.records import DynamicLoad
from pymc_features.structures.base import (
    FINITE,
    NOT_NEGATIVE,
    Described,
    Input,
    Kind,
    Structure,
    is_numeric,
    scalar,
)
from pymc_features.structures.chains import check_yielding

type Value = float | Variable

PLAIN = "plain numbers"
NO_MASS = (
    "`structure` must have masses for this, got a HystereticSpecimen. It has a force under a prescribed "
    "displacement, and neither matrices nor modes."
)


class Deterioration(Described):
    """Base: numbers or variables by name, in the order of the kernels."""

    def values(self) -> tuple[Value, ...]:
        """The parameters, in their order."""
        return tuple(getattr(self, name) for name in self.inputs)

    def __repr__(self):
        listed = ", ".join(f"{name}={value}" for name, value in zip(self.inputs, self.values(), strict=True))
        return f"{type(self).__name__}({listed})"


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

    inputs = {
        "strength": scalar("-", NOT_NEGATIVE, PLAIN),
        "stiffness": scalar("-", NOT_NEGATIVE, PLAIN),
    }

    def __init__(self, strength: Value = 0.0, stiffness: Value = 0.0):
        self.take(strength=strength, stiffness=stiffness)


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

    inputs = {
        "slip": scalar("-", NOT_NEGATIVE, PLAIN),
        "rate": scalar("-", NOT_NEGATIVE, PLAIN),
        "initiation": scalar("-", NOT_NEGATIVE, PLAIN),
        "spread": scalar("-", words=PLAIN),
        "spread_rate": scalar("-", NOT_NEGATIVE, PLAIN),
        "severity": scalar("-", words=PLAIN),
    }

    def __init__(
        self,
        slip: Value,
        rate: Value = 1.0,
        *,
        initiation: Value = 0.1,
        spread: Value = 0.2,
        spread_rate: Value = 0.0,
        severity: Value = 0.3,
    ):
        self.take(slip=slip, rate=rate, initiation=initiation)
        self.take(spread=spread, spread_rate=spread_rate, severity=severity)
        if is_numeric(self.slip) and self.slip >= 1.0:
            raise ValueError(
                f"`slip` must be below 1, got {self.slip:g}. With 1 a spring would slip without force."
            )


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

    family = "specimen"
    is_linear = False
    inputs = {
        "stiffness": scalar("N/m"),
        "yield_displacement": scalar("m"),
        "post_yield_ratio": scalar("-", NOT_NEGATIVE, "fractions of the initial stiffness"),
        "sharpness": scalar("-", words="plain numbers, 1 or more"),
        "beta": scalar("-", words=PLAIN),
        "gamma": scalar("-", FINITE, PLAIN),
        "degradation": Input(Kind.DEGRADATION),
        "pinching": Input(Kind.PINCHING),
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
        self.take(stiffness=stiffness, yield_displacement=yield_displacement)
        self.take(post_yield_ratio=post_yield_ratio, sharpness=sharpness, beta=beta, gamma=gamma)
        for name, value, kind in (
            ("degradation", degradation, Degradation),
            ("pinching", pinching, Pinching),
        ):
            if not isinstance(value, kind | None):
                raise TypeError(
                    f"`{name}` must be a {kind.__name__}, got {type(value).__name__}. Leave it out for none."
                )
        self.degradation = Degradation() if degradation is None else degradation
        self.pinching = Pinching(0.0) if pinching is None else pinching
        check_yielding(self, "Pass post-yield over initial stiffness.", "Pass 1 to 3 for gradual yielding.")
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
        loops = [getattr(self, name) for name in self.inputs if name not in ("degradation", "pinching")]
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
        self.check_load(record)
        return record.inputs[0]

    def matrices(self) -> NoReturn:
        raise TypeError(NO_MASS)

    def modes(self, n_modes: int | None = None) -> NoReturn:
        raise TypeError(NO_MASS)

    def inertia(self) -> NoReturn:
        raise TypeError(NO_MASS)


SPECIMENS = (HystereticSpecimen,)
DETERIORATIONS = (Degradation, Pinching)
