"""`pmf.sample_smc` with its default kernel, `PersistentSMC`."""

import pymc_features as pmf


def sample(model, seed):
    """One chain of 1000 draws."""
    quiet = {"progressbar": False, "compute_convergence_checks": False}
    return pmf.sample_smc(1000, chains=1, cores=1, random_seed=seed, model=model, **quiet)
