"""NUTS as `pm.sample` runs it: two chains of 1000 + 500 draws from its own starts."""

import pymc as pm


def by(nuts_sampler):
    """`sample(model, seed)` with PyMC's own NUTS, nutpie or NumPyro (optional)."""

    def sample(model, seed):
        if nuts_sampler != "pymc":
            __import__(nuts_sampler)  # an ImportError says that it is not installed
        keep = {} if nuts_sampler == "numpyro" else {"discard_tuned_samples": False}
        return pm.sample(
            500,
            tune=1000,
            chains=2,
            cores=1,
            model=model,
            nuts_sampler=nuts_sampler,
            random_seed=seed,
            progressbar=False,
            compute_convergence_checks=False,
            **keep,
        )

    return sample
