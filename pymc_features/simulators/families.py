"""Families of structures: for each the inputs of its kernels, and the kernels.

All kernels take the family's parameters, its constants, then the excitation, the record's step, substeps,
stride, sensors, number of modes and the code of the quantity; some take more behind that:

response                -                                   the history (s, u)
discrepancy             data (s, u)                         mean squares (s,) of the misfit, Eq. (3)
misfit                  data                                its statistics (s, 4), see `chain_misfit`
response_gradient       cotangent W (s, u)                  gradient of sum W y by each parameter
discrepancy_gradient    data, weights c (s,)                gradient of sum c_j e_j by each parameter
response_tangent        a direction of each parameter       derivative (s, u) along it
discrepancy_tangent     data, directions                    derivative (s,) along it
population_discrepancy  data                                (p, s), with parameters (p, ...) or (1, ...)
population_misfit       data                                (p, s, 4)
population_gradient     data, weights (p, s)                gradients in the shapes of the parameters

What describes no structure gives NaN, in its own rows. A new family is one entry here.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pymc_features.simulators.discrepancy import chain_discrepancy, chain_misfit
from pymc_features.simulators.gradient import discrepancy_gradient, population_gradient, response_gradient
from pymc_features.simulators.population import population_discrepancy, population_misfit
from pymc_features.simulators.recursion import chain_response
from pymc_features.simulators.tangent import discrepancy_tangent, response_tangent


class Family(NamedTuple):
    """A family of structures; shapes are strings of dimensions, as in "(n),(2)" of a gufunc.

    Attributes
    ----------
    parameters : dict
        Name and shape of what may be random and is differentiated.
    kernels : dict
        The functions above.
    constants : dict
        Name and shape of what all particles share, float64; integers if the name is in `integers`.
    excitation, sensors : str
        Shapes: one ground acceleration or several inputs; degrees of freedom, or a matrix S of outputs.
    compiled : bool
        Whether the kernels can be called from compiled code.
    """

    parameters: dict[str, str]
    kernels: dict[str, Callable]
    constants: dict[str, str] = {}  # noqa: RUF012
    integers: tuple[str, ...] = ()
    excitation: str = "t"
    sensors: str = "s"
    compiled: bool = False

    @property
    def inputs(self) -> dict[str, str]:
        """Name and shape of all inputs common to the kernels, in their order."""
        return (
            self.parameters
            | self.constants
            | {"acceleration": self.excitation, "dt": "", "substeps": "", "stride": ""}
            | {"sensors": self.sensors, "n_modes": ""}
        )

    def dtype(self, name: str) -> str:
        """Type of an input."""
        whole = ("substeps", "stride", "n_modes", *self.integers)
        return "int64" if name in whole or (name == "sensors" and self.sensors == "s") else "float64"

    def place_of_sensors(self, sensors: np.ndarray, n_dof: int) -> np.ndarray:
        """Degrees of freedom (s,), or outputs (s, n), as the kernels take them."""
        if self.sensors == "s" or sensors.ndim == 2:
            return sensors
        return np.eye(n_dof)[sensors]


SPRINGS = {"mass": "n", "stiffness": "n", "rayleigh": "2", "ratios": "n"}

FAMILIES = {
    "chain": Family(
        SPRINGS,
        {
            "response": chain_response,
            "discrepancy": chain_discrepancy,
            "misfit": chain_misfit,
            "response_gradient": response_gradient,
            "discrepancy_gradient": discrepancy_gradient,
            "response_tangent": response_tangent,
            "discrepancy_tangent": discrepancy_tangent,
            "population_discrepancy": population_discrepancy,
            "population_misfit": population_misfit,
            "population_gradient": population_gradient,
        },
        compiled=True,
    ),
}
