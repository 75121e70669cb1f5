"""What a specimen is taken through: the displacement of a quasi-static test."""

from dataclasses import dataclass, field, replace

import numpy as np

from pymc_features._checks import as_numbers, check_finite, check_integer, check_step, check_title
from pymc_features.records import FILL, DynamicLoad


@dataclass(frozen=True, eq=False, repr=False)
class CyclicTest(DynamicLoad):
    """The displacement that a specimen is taken through, slowly: a quasi-static test. Immutable.

    Between its samples the displacement is taken as linear. The specimen is untouched at zero, and goes
    straight from there to the first sample.

    Parameters
    ----------
    displacement : array_like (time,)
        Prescribed displacement [m], from where the force is zero; copied, float64, at least two finite
        samples.
    dt : float
        Interval of the samples [s], positive. It labels axes and nothing else, for the force does not depend
        on the speed: by default the times are the numbers of the samples.
    name : str
        What figures and messages call the test.

    Raises
    ------
    ValueError
        If the displacement is not a one-dimensional series of finite numbers or `dt` is not positive.

    Examples
    --------
    >>> CyclicTest([0.0, 0.01, -0.01, 0.02], name="column")
    CyclicTest('column', 4 samples, from -0.01 to 0.02 m)
    """

    displacement: np.ndarray = field()
    dt: float = 1.0
    name: str = ""
    is_displacement = True

    def __post_init__(self):
        advice = "Pass m, or read a table with `read_cyclic_test`."
        displacement = as_numbers(self.displacement, "displacement", advice)
        if displacement.ndim != 1 or displacement.size < 2:
            raise ValueError(
                f"`displacement` must be one-dimensional with at least 2 samples, got shape "
                f"{displacement.shape}. Pass the history of one displacement."
            )
        check_finite(displacement, "displacement", FILL)
        object.__setattr__(self, "displacement", displacement)
        object.__setattr__(self, "dt", check_step(self.dt))
        object.__setattr__(self, "name", check_title(self.name))

    def __repr__(self):
        label = f"{self.name!r}, " if self.name else ""
        low, high = self.displacement.min(), self.displacement.max()
        return f"CyclicTest({label}{self.n_times} samples, from {low:.4g} to {high:.4g} m)"

    def __len__(self):
        return self.n_times

    @property
    def inputs(self) -> np.ndarray:
        """The displacement as one input (1, time)."""
        return self.displacement[None]

    def first(self, n_times: int) -> "CyclicTest":
        """Cut the test to its first samples."""
        return replace(self, displacement=self.displacement[: check_integer(n_times, "n_times", least=2)])
