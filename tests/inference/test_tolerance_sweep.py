"""tolerance_sweep: intervals against exact ones, and tolerances out of reach."""

import numpy as np
import pymc as pm
import pytest

from pymc_features import DiscrepancySimulator
from pymc_features.exceptions import ToleranceNotReachedError
from pymc_features.sampling import tolerance_sweep

QUIET = {"chains": 2, "cores": 1, "progressbar": False, "compile_kwargs": {"mode": "FAST_COMPILE"}}


def distance(x, z):
    """rho = x^2 + 0.1."""
    return np.stack([x, np.full(x.shape, np.sqrt(0.1))], axis=-1)


distance.batched = True


@pytest.fixture(scope="module")
def model():
    """x is uniform where x^2 <= epsilon - 0.1, and z whatever it was."""
    with pm.Model() as model:
        x, z = pm.Uniform("x", -1.0, 1.0), pm.Normal("z", shape=2)
        DiscrepancySimulator("y", distance, x, z[0], epsilon=123.0, observed=np.zeros(2))
    return model


@pytest.fixture(scope="module")
def sweep(model):
    """From a tolerance that nothing is outside of to one that nothing is inside of."""
    return tolerance_sweep([0.05, 0.101, 2.0, 0.2], model=model, draws=1000, random_seed=3, **QUIET)


def test_intervals_are_the_exact_ones(sweep, tmp_path):
    """Quantiles of 2 x 1000 draws within 6 % of the width: four standard errors."""
    np.testing.assert_array_equal(sweep["epsilon"], [2.0, 0.2, 0.101, 0.05])
    half = np.minimum(np.sqrt(sweep["epsilon"].values[:3] - 0.1), 1.0)
    for k, q in enumerate([0.05, 0.5, 0.95]):
        exact = (2 * q - 1) * half
        assert (np.abs(sweep["x"].values[:3, k] - exact) < 0.06 * 2 * half).all()
    assert (np.abs(sweep["x"].values[:2, 2] - 0.9 * half[1]) > 0.06).any(), "control: the first is wider"
    error = sweep["log_probability"].values[:3] - np.log(half)
    assert (np.abs(error) <= 4 * sweep["log_probability_se"].values[:3] + 1e-12).all()
    assert sweep["z"].dims[:2] == ("epsilon", "quantile")
    assert sweep["z"].shape[2:] == (2,)
    last = sweep.sel(epsilon=0.05)  # out of reach
    assert all(np.isnan(last[name]).all() for name in last.data_vars)
    assert (sweep["simulations"].values[:3] > 1000).all()
    sweep.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ({"epsilon": [0.0, 1.0]}, ValueError, r"`epsilon` must be positive and finite, got \[1.0, 0"),
        ({"epsilon": []}, ValueError, r"`epsilon` must be positive and finite, got \[\]"),
        ({"epsilon": ["a"]}, TypeError, "`epsilon` must be numbers, got list of texts"),
        ({"probability": 1.0}, ValueError, "`probability` must lie between 0 and 1, got 1.0. Pass 0.9"),
        (
            {"epsilon": [0.05]},
            ToleranceNotReachedError,
            "`epsilon` must be within reach of the simulator, got 0.05 as the largest",
        ),
    ],
)
def test_refusals(model, arguments, error, match):
    with pytest.raises(error, match=match):
        tolerance_sweep(**({"epsilon": [0.2], "model": model, "draws": 200} | QUIET | arguments))


def test_names_of_the_result_are_no_parameters():
    with pm.Model() as model:
        x = pm.Uniform("simulations", -1.0, 1.0)
        DiscrepancySimulator("y", distance, x, x, epsilon=1.0, observed=np.zeros(2))
    with pytest.raises(ValueError, match="`model` must not have parameters named simulations. Rename them"):
        tolerance_sweep([1.0], model=model)
