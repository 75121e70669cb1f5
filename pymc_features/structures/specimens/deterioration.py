"""What cycles do to a hysteretic spring: strength and stiffness degrade, loops are pinched."""

from pytensor.graph.basic import Variable

from pymc_features.structures.base import as_vector
from pymc_features.structures.inputs import Input, scalar

type Value = float | Variable


def scalar_of(value, name: str, unit: str, *, allow_zero: bool = False) -> Value:
    """Return a checked float, or a scalar tensor."""
    checked = as_vector(value, name, unit, allow_zero=allow_zero)
    if checked.ndim:
        raise ValueError(
            f"`{name}` must be a scalar, got {checked.ndim} dimension. Pass one value in {unit}."
        )
    return checked if isinstance(checked, Variable) else float(checked)


class Deterioration:
    """Base: numbers or variables by name, in the order of the kernels.

    Attributes
    ----------
    inputs : dict
        Names of its arguments to what they may be in a file.
    """

    inputs: dict[str, Input]

    def values(self) -> tuple[Value, ...]:
        """The parameters, in their order."""
        return tuple(getattr(self, name) for name in self.inputs)

    def __repr__(self):
        given = ", ".join(f"{name}={value}" for name, value in zip(self.inputs, self.values(), strict=True))
        return f"{type(self).__name__}({given})"


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

    inputs = {"strength": scalar("-"), "stiffness": scalar("-")}

    def __init__(self, strength: Value = 0.0, stiffness: Value = 0.0):
        self.strength = scalar_of(strength, "strength", "plain numbers", allow_zero=True)
        self.stiffness = scalar_of(stiffness, "stiffness", "plain numbers", allow_zero=True)


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
        "slip": scalar("-"),
        "rate": scalar("-"),
        "initiation": scalar("-"),
        "spread": scalar("-"),
        "spread_rate": scalar("-"),
        "severity": scalar("-"),
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
        unit = "plain numbers"
        self.slip = scalar_of(slip, "slip", unit, allow_zero=True)
        if not isinstance(self.slip, Variable) and self.slip >= 1.0:
            raise ValueError(
                f"`slip` must be below 1, got {self.slip:g}. With 1 a spring would slip without force."
            )
        self.rate = scalar_of(rate, "rate", unit, allow_zero=True)
        self.initiation = scalar_of(initiation, "initiation", unit, allow_zero=True)
        self.spread = scalar_of(spread, "spread", unit)
        self.spread_rate = scalar_of(spread_rate, "spread_rate", unit, allow_zero=True)
        self.severity = scalar_of(severity, "severity", unit)


NO_DEGRADATION, NO_PINCHING = Degradation(), Pinching(0.0)
