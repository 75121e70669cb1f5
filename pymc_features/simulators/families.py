"""Families of structures: for each the inputs of its kernels, and the kernels.

All kernels take three named tuples, and some take more behind them: the parameters and constants of the
family, see `arguments`; the `Excitation`; and the `Outputs` wanted.

response                -                                   the history (s, u)
history                 -                                   the same for Python, by the machine code of
                                                            populations; may lack
discrepancy             data (s, u)                         mean squares (s,) of the misfit, Eq. (3)
misfit                  data                                its statistics (s, 4), see `chain_misfit`
response_gradient       cotangent W (s, u)                  gradient of sum W y by each parameter
misfit_gradient         data, weights c (s, 1) or (s, 4)    gradient of sum c_jq times those statistics
response_tangent        tuple of a direction of each         derivative (s, u) along it
discrepancy_tangent     data, tuple of directions           derivative (s,) along it
population_discrepancy  data                                (p, s), with parameters (p, ...) or (1, ...)
population_misfit       data                                (p, s, 4)
population_systems      data                                modes, see `long_records`, or None; may lack
population_gradient     data, weights (p, s, 1) or (.., 4)  gradients in the shapes of the parameters
discrepancy_gradient    data, weights (s, 1)                as misfit_gradient; may lack
gradient_systems        data                                modes of those of whom there is the following
gradient_of_sums        sums over time, see `reduction`     as population_gradient; both may lack

What describes no structure gives NaN, in its own rows. NaN in the data is a gap: the first statistic, and
what follows from it, is of the other samples, over the number of all; the others are NaN then. A new family
is one entry here.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features.simulators.chain.kernels import (
    chain_discrepancy,
    chain_gradient_of_sums,
    chain_history,
    chain_misfit,
    chain_response,
    chain_systems,
    discrepancy_gradient,
    misfit_gradient,
    population_discrepancy,
    population_gradient,
    population_misfit,
    response_gradient,
)
from pymc_features.simulators.chain.parameters import ChainParameters
from pymc_features.simulators.cyclic import KERNELS as OF_SPECIMENS
from pymc_features.simulators.cyclic import SpecimenParameters
from pymc_features.simulators.linear.arguments import LinearParameters
from pymc_features.simulators.linear.gradient import (
    linear_gradient_of_sums,
    linear_misfit_gradient,
    linear_population_gradient,
    linear_response_gradient,
)
from pymc_features.simulators.linear.response import (
    linear_discrepancy,
    linear_gradient_systems,
    linear_misfit,
    linear_population_discrepancy,
    linear_population_misfit,
    linear_response,
    linear_systems,
)
from pymc_features.simulators.modal.chain import (
    chain_frequencies,
    chain_modes_gradient,
    chain_population_modes,
    small_motion_gradient,
    small_motion_modes,
)
from pymc_features.simulators.modal.linear import (
    linear_frequencies,
    linear_modes_gradient,
    linear_population_modes,
)
from pymc_features.simulators.nonlinear.bouc_wen.law import BoucWen
from pymc_features.simulators.nonlinear.duffing import Cubic
from pymc_features.simulators.nonlinear.kernels import nonlinear_kernels
from pymc_features.simulators.nonlinear.law import NonlinearParameters
from pymc_features.simulators.oscillators.arguments import Excitation, Outputs
from pymc_features.simulators.oscillators.differences import SMOOTH, tangents


class Family(NamedTuple):
    """A family of structures; shapes are strings of dimensions, as in "(n),(2)" of a gufunc.

    Attributes
    ----------
    arguments : type
        Named tuple of the parameters and constants.
    parameters : dict
        Name and shape of what may be random and is differentiated.
    kernels : dict
        The functions above.
    constants : dict
        Name and shape of what all particles share, float64; integers if the name is in `integers`.
    excitation, sensors : str
        Shapes: one ground acceleration (of a specimen: its displacement) or several inputs; degrees of
        freedom, or a matrix S of outputs.
    asks_what_is_sought : bool
        Whether the gradients take names of what they are wanted by, for each number costs responses.
    modal : dict
        The functions of `modal`, of a population: parameters and `Outputs` in, and a `Cotangent` for the
        gradient. None where there is no mass.
    """

    arguments: type
    parameters: dict[str, str]
    kernels: dict[str, Callable]
    constants: dict[str, str] = {}  # noqa: RUF012
    integers: tuple[str, ...] = ()
    excitation: str = "t"
    sensors: str = "s"
    asks_what_is_sought: bool = False
    modal: dict[str, Callable] = {}  # noqa: RUF012

    @property
    def inputs(self) -> dict[str, str]:
        """Name and shape of all inputs common to the kernels, in their order."""
        return (
            self.parameters
            | self.constants
            | {"acceleration": self.excitation, "dt": "", "substeps": "", "stride": "", "direct": "o,i,v"}
            | {"sensors": self.sensors, "n_modes": ""}
        )

    @property
    def history(self) -> Callable:
        """The response as Python calls it."""
        return self.kernels.get("history", self.kernels["response"])

    def of_squares(self, name: str) -> Callable:
        """The kernel of a name, or the smaller one of mean squares alone, where there is one."""
        alone = name.replace("misfit_", "").replace("gradient", "discrepancy_gradient")
        return self.kernels.get(alone, self.kernels[name])

    def assemble(self, inputs, quantity: int) -> tuple:
        """The three named tuples of a kernel, from inputs in the order of `inputs`."""
        n = len(self.arguments._fields)
        return (
            self.arguments(*inputs[:n]),
            Excitation(*inputs[n : n + 5]),
            Outputs(*inputs[n + 5 :], quantity),
        )

    def dtype(self, name: str) -> str:
        """Type of an input."""
        whole = ("substeps", "stride", "n_modes", *self.integers)
        whole += () if self.takes_outputs else ("sensors",)
        return "int64" if name in whole else "float64"

    @property
    def takes_outputs(self) -> bool:
        """Whether the kernels take combinations of degrees of freedom, S (s, n)."""
        return count(self.sensors) == 2

    def inputs_of(self, structure, record, excitation, rows, n_modes: int) -> list:
        """Inputs in the order of `inputs`, for an excitation, and rows as from `rows`.

        Arrays that may not be written are copied: Numba would compile the kernels for these once more.
        """
        arrays = *structure.parameters(), *structure.constants(record)
        arrays = [np.require(x, requirements="W") if isinstance(x, np.ndarray) else x for x in arrays]
        return [*arrays, *excitation, rows, n_modes]

    def rows(self, picked: np.ndarray, n_dof: int):
        """Degrees of freedom (s,) as the kernels take them; sparse where that is a matrix (s, n)."""
        if not self.takes_outputs or picked.ndim == 2:
            return picked
        entries = np.ones(picked.size), (np.arange(picked.size), picked)
        return sparse.csr_array(entries, shape=(picked.size, n_dof))


def count(dims: str) -> int:
    """Number of dimensions of a shape such as "s,n"."""
    return len(dims.split(",")) if dims else 0


NONLINEAR = {"hysteretic": BoucWen, "duffing": Cubic}  # the law of the springs
SPRINGS = {"mass": "n", "stiffness": "n", "rayleigh": "2", "ratios": "n"}
OF_CHAINS = {"frequencies": chain_frequencies}

FAMILIES = {
    "chain": Family(
        ChainParameters,
        SPRINGS,
        {
            "response": chain_response,
            "discrepancy": chain_discrepancy,
            "misfit": chain_misfit,
            "response_gradient": response_gradient,
            "misfit_gradient": misfit_gradient,
            "discrepancy_gradient": discrepancy_gradient,
            "history": chain_history,
            **tangents(chain_history, 4, SMOOTH),
            "population_discrepancy": population_discrepancy,
            "population_misfit": population_misfit,
            "population_systems": chain_systems,
            "population_gradient": population_gradient,
            "gradient_systems": chain_systems,
            "gradient_of_sums": chain_gradient_of_sums,
        },
        modal=OF_CHAINS | {"modes": chain_population_modes, "modes_gradient": chain_modes_gradient},
    ),
    "linear": Family(
        LinearParameters,
        {"theta": "p", "rayleigh": "2", "ratios": "k"},
        {
            "response": linear_response,
            "discrepancy": linear_discrepancy,
            "misfit": linear_misfit,
            "response_gradient": linear_response_gradient,
            "misfit_gradient": linear_misfit_gradient,
            **tangents(linear_response, 3, SMOOTH),
            "population_discrepancy": linear_population_discrepancy,
            "population_misfit": linear_population_misfit,
            "population_systems": linear_systems,
            "population_gradient": linear_population_gradient,
            "gradient_systems": linear_gradient_systems,
            "gradient_of_sums": linear_gradient_of_sums,
        },
        constants={
            "mass": "a,e",
            "damping": "b,e",
            "stiffness": "c,e",
            "rows": "r",
            "starts": "q",
            "influence": "n,d",
            "forces": "n,d",
        },
        integers=("rows", "starts"),
        excitation="d,t",
        sensors="s,n",
        modal={
            "frequencies": linear_frequencies,
            "modes": linear_population_modes,
            "modes_gradient": linear_modes_gradient,
        },
    ),
    "specimen": Family(SpecimenParameters, {"law": "l"}, OF_SPECIMENS),
}
SMALL_MOTIONS = OF_CHAINS | {"modes": small_motion_modes, "modes_gradient": small_motion_gradient}
FAMILIES |= {
    name: Family(
        NonlinearParameters,
        SPRINGS | {"law": "l,n"},
        nonlinear_kernels(law),
        asks_what_is_sought=True,
        modal=SMALL_MOTIONS,
    )
    for name, law in NONLINEAR.items()
}
