"""The chain with springs that harden with the cube of their drift."""

from pymc_features.structures.base import Values
from pymc_features.structures.damping import Damping
from pymc_features.structures.inputs import vector
from pymc_features.structures.masses_and_springs import Chain


class DuffingChain(Chain):
    """A spring-mass chain whose springs have the force f = k d + c d^3, with the drift d.

    Parameters
    ----------
    mass, stiffness, damping
        As of `SpringMassChain`; `stiffness` is k, that of small drifts, and damping is formed with it.
    cubic : float, array_like (n,) or TensorVariable
        c [N/m^3], not negative; one value stands for all. With zero the chain is linear.

    Raises
    ------
    ValueError, TypeError
        If a number is out of its range or lengths differ.

    Notes
    -----
    Accuracy and cost as of `HystereticChain` with n = 2. Where a draw leaves the ranges, the response is NaN.
    Several masses on springs that harden to many times k move chaotically: no solution is accurate for long;
    `integration_error` tells.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> chain = DuffingChain(mass=1.0, stiffness=[100.0, 100.0], damping=ModalDamping(0.02), cubic=5e4)
    >>> chain.modes().angular_frequencies.round(6)  # of small motions
    array([ 6.18034, 16.18034])
    """

    family = "duffing"
    is_linear = False
    inputs = Chain.inputs | {"cubic": vector("N/m^3")}

    def __init__(self, mass: Values, stiffness: Values, damping: Damping, cubic: Values):
        super().__init__(mass, stiffness, damping)
        self.cubic = self.spring_vector(cubic, "cubic", "N/m^3", allow_zero=True)

    def parameters(self) -> tuple:
        return *self.linear_parameters(), self.spring_table(self.cubic)
