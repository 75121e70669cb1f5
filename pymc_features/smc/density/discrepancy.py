"""What a sampler that lowers the tolerance must know of a model with a `pm.Simulator` node."""

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.simulator import SimulatorRV, gaussian, laplace
from pymc.logprob.abstract import _logprob
from pytensor.compile.mode import Mode
from pytensor.graph.traversal import ancestors

from pymc_features._checks import as_numbers, message, shown


class SimulatorNode:
    """The one `pm.Simulator` node of a model, as a discrepancy rho and a tolerance on it.

    Parameters
    ----------
    model : pymc.Model
        With one simulator among its observed variables; other likelihoods and potentials are allowed.

    Attributes
    ----------
    hard : bool
        Whether the node's own kernel is the threshold rho <= epsilon.

    Notes
    -----
    A distance may have an attribute `minus_rho`, a distance that returns -rho, and `hard`, as those of
    `DiscrepancySimulator`. Of PyMC's, "gaussian" has rho = |s(y) - s(x)|_2 and "laplace" |s(y) - s(x)|_1, and
    of a function of the user's the negative log-density is taken for rho / epsilon. Where epsilon is an
    array, rho stands for that ratio, and its tolerance is 1.
    """

    def __init__(self, model):
        found = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, SimulatorRV)]
        if len(found) != 1:
            names = ", ".join(rv.name for rv in found) or "none"
            raise ValueError(
                f"`model` must have one pm.Simulator node, got {names}. Declare one with "
                "DiscrepancySimulator, or sample with pmf.sample_smc(), which takes any model."
            )
        self.model = model
        [self.rv] = found
        self.op = self.rv.owner.op
        self.distance = type(self.op)._distance  # looked up in the instance, a function would be a method
        if self.model.free_RVs and set(self.model.free_RVs) & set(ancestors([self.op.epsilon])):
            raise TypeError(
                f"`epsilon` of {self.rv.name} must be a number, an array or pm.Data, got one that depends on "
                "random variables. Look at several tolerances with sampling.tolerance_sweep()."
            )
        self.hard = getattr(self.distance, "hard", False)

    @property
    def has_one_tolerance(self) -> bool:
        """Whether epsilon is one number."""
        return self.op.epsilon.ndim == 0

    def tolerance(self, asked=None) -> float:
        """The tolerance asked for, or else the node's, from its data as they are now."""
        if asked is not None and not self.has_one_tolerance:
            wanted = f"left out where {self.rv.name} has one for each sensor"
            raise ValueError(message("epsilon", wanted, shown(asked)))
        epsilon = self.op.epsilon.eval(mode=Mode(linker="py", optimizer=None)) if asked is None else asked
        values = as_numbers(epsilon, "epsilon", what="a number")
        if asked is not None and values.ndim > 0:
            raise ValueError(message("epsilon", "one number", shown(values.tolist())))
        if not (np.isfinite(values) & (values > 0)).all():
            raise ValueError(message("epsilon", "positive and finite", shown(values.tolist())))
        return float(values) if self.has_one_tolerance else 1.0

    def base_terms(self) -> tuple:
        """Log prior, and the log-density of whatever else the model conditions on."""
        others = [rv for rv in self.model.observed_RVs if rv is not self.rv]
        rest = pt.zeros(())
        if others:
            rest = rest + self.model.logp(vars=others)
        if self.model.potentials:
            rest = rest + self.model.potentiallogp
        return self.model.varlogp, rest

    @property
    def conditions_on_more(self) -> bool:
        """Whether the model has other likelihoods or potentials."""
        return len(self.model.observed_RVs) > 1 or len(self.model.potentials) > 0

    def rho_terms(self) -> tuple:
        """Zero, and -rho."""
        [minus_rho] = self.model.replace_rvs_by_values([self._minus_rho()])
        return pt.zeros(()), minus_rho

    def _minus_rho(self):
        value = self.model.rvs_to_values[self.rv]
        inputs = self.rv.owner.inputs
        own = getattr(self.distance, "minus_rho", None)
        changes = {}
        if own is not None:
            changes = {"_distance": own}
        elif self.has_one_tolerance and self.distance in (gaussian, laplace):
            changes = {"epsilon": 1.0}  # no rounding by a division: the edge is exactly where rho = epsilon
        op = type(type(self.op).__name__, (type(self.op),), changes)() if changes else self.op
        minus_rho = pt.sum(_logprob(op, [value], *inputs))
        if self.distance is gaussian:
            minus_rho = -pt.sqrt(-2.0 * minus_rho)
        return minus_rho * self.op.epsilon if not changes and self.has_one_tolerance else minus_rho
