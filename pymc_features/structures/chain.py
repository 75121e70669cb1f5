"""The spring-mass chain (shear building) of Eqs. (17)-(19)."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable

from pymc_features.structures.affine import AffineStructure
from pymc_features.structures.masses_and_springs import Chain


class SpringMassChain(Chain):
    """Masses in a row, each joined to the one below by a spring, the first to the moving base.

    Parameters
    ----------
    mass : float, array_like (n,) or TensorVariable
        Masses [kg], positive, the one next to the base first; one value stands for all.
    stiffness : float, array_like (n,) or TensorVariable
        Spring constants [N/m], positive; spring i joins mass i to mass i - 1, spring 0 to the base.
    damping : Damping
        `RayleighDamping` or `ModalDamping`.

    Raises
    ------
    ValueError, TypeError
        If a number is not positive, lengths differ, or no length is known.

    Notes
    -----
    A variable with the `dims` of a model has the length of their coordinates, here and in dampings.
    Numbers are checked here; variables cannot be. Where a draw makes a mass or a spring negative,
    the response is NaN and the likelihoods of this package are -inf.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> chain = SpringMassChain(mass=[1.0, 1.0], stiffness=[100.0, 100.0], damping=ModalDamping(0.02))
    >>> chain.modes().angular_frequencies.round(6)  # 10 (sqrt(5) -+ 1) / 2
    array([ 6.18034, 16.18034])
    """

    family = "chain"

    def as_linear(self) -> AffineStructure:
        """Return the same structure by its matrices; its theta are the masses, then the springs."""
        n = self.n_dof
        mass, stiffness, *_ = self.linear_parameters()
        drifts = np.diff(np.eye(n), axis=0, prepend=0.0)
        symbolic = isinstance(mass, Variable) or isinstance(stiffness, Variable)
        return AffineStructure(
            np.zeros((n, n)),
            stiffness=np.zeros((n, n)),
            damping=self.damping,
            mass_terms=[*(np.diag(unit) for unit in np.eye(n)), *(None,) * n],
            stiffness_terms=[*(None,) * n, *(np.outer(drift, drift) for drift in drifts)],
            theta=pt.concatenate([mass, stiffness]) if symbolic else np.concatenate([mass, stiffness]),
        )
