"""`pmf.sample_nuts` from particles of `PersistentSMC`, whose evaluations count as well."""

import numpy as np

import pymc_features as pmf
from benchmarks.samplers.run import total


def sample(model, seed):
    """SMC of 1000 draws, then two chains of 500 + 500."""
    quiet = {"progressbar": False, "compute_convergence_checks": False}
    particles = pmf.sample_smc(1000, chains=1, cores=1, random_seed=seed, model=model, **quiet)
    idata = pmf.sample_nuts(
        500,
        tune=500,
        chains=2,
        cores=1,
        particles=particles,
        model=model,
        random_seed=seed,
        progressbar=False,
        discard_tuned_samples=False,
    )
    used = {
        "evaluations": float(np.nansum(particles["sample_stats"]["evaluations"].values)),
        "gradients": total(idata, "n_steps"),
    }
    idata["sample_stats"] = type(idata)(idata["sample_stats"].to_dataset().assign(used))
    return idata
