"""The Duffing law: a spring that hardens with the cube of its drift, f = k d + c d^3."""

from typing import NamedTuple

from pymc_features.simulators.nonlinear.law import register
from pymc_features.simulators.nonlinear.polynomial import polynomial
from pymc_features.simulators.taylor.series import Group


class Cubic(NamedTuple):
    """The parameter of each spring: cubic coefficient c [N/m^3]."""

    address: int
    rows: int
    n: int


class CubicGroup(Group):
    """Chains in lanes, of this law."""


register(Cubic, polynomial(CubicGroup, 3, order=9))
