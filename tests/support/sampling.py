"""Silent samplers, one chain of a kernel by itself, and means over independent seeds."""

from types import SimpleNamespace

import numpy as np
import pytensor.tensor as pt

QUIET = {"progressbar": False, "compute_convergence_checks": False}
SERIAL = {"cores": 1, **QUIET}


def run_chain(kernel, model, draws=1000, seed=0, **settings):
    """One chain: draws, evidence and the statistics of its stages; of subset simulation also rho and cost."""
    one = kernel(draws, model=model, random_seed=seed, **settings)
    one.initialize(None, np.random.default_rng(seed))
    stages = []
    while one.beta < 1.0:
        one.update_beta_and_weights()
        stages.append(one.step())
    return SimpleNamespace(
        draws=one.tempered_posterior,
        evidence=one.log_marginal_likelihood,
        se=stages[-1].get("log_marginal_likelihood_se"),
        stages=stages,
        rho=getattr(one, "rho", None),
        simulations=getattr(one, "simulations", None),
    )


def log_add(a, b):
    """ln(e^a + e^b) by functions of NumPy; PyTensor's own is called for each particle by itself."""
    return pt.maximum(a, b) + pt.log1p(pt.exp(-pt.abs(a - b)))


def mean_within_errors(values, expected=0.0, error=0.0, limit=4.0):
    """Whether the mean of values from independent seeds is within `limit` of its standard errors.

    `error` is that of the expected value.
    """
    spread = np.hypot(np.std(values, ddof=1) / np.sqrt(len(values)), error)
    return abs(np.mean(values) - expected) < limit * spread
