"""Whether what a model leaves of the data is noise."""

import numpy as np
from scipy.stats import chi2

from pymc_features.calibration.comparison import log_likelihood
from pymc_features.calibration.fit import Predictions
from pymc_features.calibration.peaks import some_draws
from pymc_features.inference.parameters import posterior_for

LAGS = 20


def residual_whiteness(model, idata) -> float:
    """p-value of white residuals at the likeliest of some draws, of the worst sensor, times their number.

    Ljung & Box, Biometrika 65, 1978, with 20 lags. Residuals are those that the likelihood takes to be
    independent: of a `CorrelatedNormal` what each sample adds.
    """
    posterior, predictions = posterior_for(model, idata, "models"), Predictions(model)
    values = [predictions(z) for z in some_draws(model, posterior)]
    best = values[int(np.argmax([log_likelihood(value) for value in values]))]
    p_values = [ljung_box(row) for value in best for row in value.residuals]
    return float(min(1.0, len(p_values) * min(p_values)))


def ljung_box(x: np.ndarray) -> float:
    """p-value of a white series (time,)."""
    n, x = len(x), x - x.mean()
    lags = np.arange(1, min(LAGS, n // 5) + 1)
    if not lags.size or not x.any():
        return 1.0
    correlations = np.array([x[k:] @ x[:-k] for k in lags]) / (x @ x)
    return float(chi2.sf(n * (n + 2) * np.sum(correlations**2 / (n - lags)), len(lags)))
