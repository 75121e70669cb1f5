"""The kernel for narrow posteriors, on models that know nothing of structures."""

import numpy as np
import pymc as pm
import pytest
from pymc.smc.kernels import IMH
from scipy import stats

from pymc_features import RelativeIMH

SCALE = 1e-5


@pytest.fixture(scope="module")
def narrow():
    """A Gaussian posterior a hundred times narrower than PyMC's jitter of 1e-3."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0)
        pm.Potential("likelihood", -0.5 * ((x - 0.3) / SCALE) ** 2)
    return model


def sample(model, kernel, seed=1):
    """Draws and the acceptance rate of the last stage."""
    idata = pm.sample_smc(
        draws=2000,
        kernel=kernel,
        model=model,
        chains=1,
        cores=1,
        random_seed=seed,
        progressbar=False,
        compute_convergence_checks=False,
    )
    return idata.posterior["x"].values.ravel(), float(np.ravel(idata.sample_stats["accept_rate"])[-1])


def test_narrow_posterior(narrow):
    """Kolmogorov-Smirnov at a false-alarm rate of 1e-3; the stock kernel's acceptance is the control."""
    draws, acceptance = sample(narrow, RelativeIMH)
    assert acceptance > 0.5
    assert stats.kstest(draws, stats.norm(0.3, SCALE).cdf).pvalue > 1e-3
    assert stats.kstest(draws, stats.norm(0.3, 1.27 * SCALE).cdf).pvalue < 1e-3
    assert len(np.unique(draws)) > 1600
    _, stock = sample(narrow, IMH)
    assert stock < 0.1


def test_equals_the_stock_kernel_where_jitter_does_not_matter():
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 100.0)
        pm.Normal("y", x, 50.0, observed=[3.0, 40.0])
    np.testing.assert_allclose(sample(model, RelativeIMH)[0], sample(model, IMH)[0], atol=1e-3)


def test_collapsed_population_is_refused():
    kernel = object.__new__(RelativeIMH)
    kernel.tempered_posterior = np.ones((10, 2))
    with pytest.raises(ValueError, match="must differ in every parameter, got a variance of 0. Increase"):
        kernel.tune()
