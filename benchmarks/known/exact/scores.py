"""A model's parameters as independent standard normal variables z: the normal scores of their priors.

Under the prior z ~ N(0, I), whatever the prior is, and where the data say little the posterior is near to
that, without the heavy tails that a logit gives a uniform prior.
"""

import numpy as np
import pytensor
import pytensor.tensor as pt
from pytensor.graph.replace import vectorize_graph
from scipy import special

from pymc_features.inference.parameters import entry_names
from pymc_features.smc.density.evaluation import population_logp
from pymc_features.smc.density.graph import joined_graph

CONSTANT = 0.5 * np.log(2.0 * np.pi)


class Uniform:
    """Uniform on (low, high); PyMC samples the logit."""

    def __init__(self, low, high):
        self.low, self.width = low, high - low

    def unconstrained(self, z):
        return special.log_ndtr(z) - special.log_ndtr(-z)

    def slope(self, z):
        """Derivative of the unconstrained value."""
        return np.exp(-0.5 * z**2 - CONSTANT - special.log_ndtr(z) - special.log_ndtr(-z))

    def parameter(self, z):
        return self.low + self.width * special.ndtr(z)


class Normal:
    """Normal, which PyMC samples as it is."""

    def __init__(self, mean, sd):
        self.mean, self.sd = mean, sd

    def unconstrained(self, z):
        return self.mean + self.sd * z

    def slope(self, z):
        return np.broadcast_to(self.sd, np.shape(z))

    parameter = unconstrained


class LogNormal(Normal):
    """Log-normal; PyMC samples the logarithm."""

    def parameter(self, z):
        return np.exp(self.unconstrained(z))


PRIORS = {"UniformRV": Uniform, "NormalRV": Normal, "LogNormalRV": LogNormal}


def entries_of(rv, value):
    """The prior of each entry of a random variable with constant parameters."""
    kind = PRIORS[type(rv.owner.op).__name__]
    parameters = [np.broadcast_to(p.eval(), value.shape) for p in rv.owner.op.dist_params(rv.owner)]
    return [kind(*(float(p[i]) for p in parameters)) for i in np.ndindex(value.shape)]


class NormalScores:
    """Log-likelihood of a model, and its gradient, for populations of points z (n, d).

    Attributes
    ----------
    labels : list of str
    values, gradients : int
        Evaluations so far.
    """

    def __init__(self, model):
        point = model.initial_point()
        assert [model.rvs_to_values[rv] for rv in model.free_RVs] == list(model.value_vars)
        self.priors, self.labels = [], []
        for rv in model.free_RVs:
            value = np.asarray(point[model.rvs_to_values[rv].name])
            self.priors += entries_of(rv, value)
            self.labels += entry_names(rv.name, value.shape)
        self.d = len(self.priors)
        self.values = self.gradients = 0
        self._value = population_logp(model, point, {})
        one = joined_graph(model, point, [model.varlogp, model.datalogp], model.value_vars)
        particles = pt.matrix("particles")
        likelihood = vectorize_graph(one.outputs[1], {one.joined: particles})
        gradient = pt.grad(likelihood.sum(), particles)
        self._gradient = pytensor.function([particles], [likelihood, gradient], on_unused_input="ignore")

    def _columns(self, z, method):
        columns = [getattr(prior, method)(z[:, i]) for i, prior in enumerate(self.priors)]
        return np.column_stack(columns)

    def parameters(self, z):
        """Parameters on their own scale (n, d)."""
        return self._columns(z, "parameter")

    def log_likelihood(self, z):
        """ln L (n,); -inf where it is not finite."""
        self.values += len(z)
        return self._value(self._columns(z, "unconstrained"))[1]

    def with_gradient(self, z):
        """ln L (n,) and its gradient in z (n, d); -inf and zero where they are not finite."""
        self.gradients += len(z)
        with np.errstate(all="ignore"):
            value, gradient = self._gradient(self._columns(z, "unconstrained"))
            gradient = gradient * self._columns(z, "slope")
        good = np.isfinite(value) & np.isfinite(gradient).all(axis=1)
        return np.where(good, value, -np.inf), np.where(good[:, None], gradient, 0.0)
