"""Calibrated intervals of specimens, where the post-yield ratio and the degradation are at their bound."""

import json

import numpy as np
import pymc as pm
import pytest
import xarray as xr

import pymc_features as pmf
from benchmarks.truth import cycles, specimen_force
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Predictions
from pymc_features.inference.parameters import to_unconstrained

LAW = [2e7, 0.008, 0.0, 2.0, 0.5, 0.5, 0.0, 0.0, 0.7, 1.0, 0.1, 0.3, 0.0, 0.3]  # in the order of `NAMES`
PATH = [1, -1, 2, -2, 3, -3, 4, -4, 5, -5]


def declare(displacement, force):
    """The specimen with what degrades it, and what it starts with."""
    largest = np.abs(force).max()
    with pm.Model() as model:
        k = pm.LogNormal("k", np.log(largest / 0.01), 0.7)
        reach = pm.LogNormal("d_y", np.log(0.01), 0.7)
        degradation = pmf.structures.Degradation(
            stiffness=pm.HalfNormal("delta_eta", 0.1), strength=pm.HalfNormal("delta_nu", 0.1)
        )
        specimen = pmf.structures.HystereticSpecimen(
            k,
            yield_displacement=reach,
            post_yield_ratio=pm.Uniform("ratio", 0.0, 0.3),
            degradation=degradation,
            pinching=pmf.structures.Pinching(pm.Uniform("slip", 0.0, 0.95), spread=0.3),
        )
        mu = pmf.response(specimen, pmf.structures.CyclicTest(displacement))
        pm.Normal("force", mu, pm.HalfNormal("sigma", 0.2 * largest), observed=force[None])
    return model


def largest_residuals(model, start):
    """Draws of CAL: rms of their residuals over that of NORM's most likely point (n,), and the result."""
    names = "k", "d_y", "delta_eta", "delta_nu", "ratio", "slip", "sigma"
    start = xr.Dataset({n: (("chain", "draw"), [[x]]) for n, x in zip(names, start, strict=True)})
    settings = {"draws": 150, "chains": 2, "stage_draws": 300, "random_seed": 1, "progressbar": False}
    found = pmf.calibrate(xr.DataTree.from_dict({"posterior": start}), model=model, **settings)
    predictions = Predictions(model)
    best = climb_likelihood(predictions, to_unconstrained(model, start)[0, 0]).z
    points = [best, *to_unconstrained(model, found["posterior"].to_dataset()).reshape(-1, 7)[::3]]
    values = [predictions(z)[0] for z in points]
    fit, *draws = (np.sqrt(np.mean((value.mu - value.observed) ** 2)) for value in values)
    return np.array(draws) / fit, found


@pytest.mark.slow
def test_simulated_loops_at_the_bound():
    """Truth by SciPy, errors that persist for five samples: the loops of all draws are those of the fit."""
    displacement = cycles(0.008, PATH, 40)
    force = specimen_force(LAW, displacement)
    rng = np.random.default_rng(1)
    errors = np.convolve(rng.standard_normal(force.size + 4), np.ones(5) / np.sqrt(5.0), mode="valid")
    model = declare(displacement, force + 0.02 * np.abs(force).max() * errors)
    residuals, found = largest_residuals(model, (2e7, 0.008, 1e-3, 1e-3, 1e-3, 0.7, 4e3))
    assert residuals.max() < 1.5
    rows = json.loads(found.attrs["calibration"])["parameters"]
    assert {"ratio", "delta_eta", "delta_nu"} <= {name for name, row in rows.items() if row["near_bound"]}
    posterior = found["posterior"].to_dataset()
    for name, value in (("k", 2e7), ("d_y", 0.008), ("slip", 0.7)):  # outside in one of 15,000 data sets
        assert abs(float(posterior[name].mean()) - value) < 4.0 * float(posterior[name].std())
    assert float(found["sample_stats"]["evaluations"].sum()) == 300  # each draw once: the rest is expanded


@pytest.mark.slow
def test_the_loops_of_a_column(data_dir):
    """Measured loops that no draw of this model follows closely, the post-yield ratio near its bound."""
    if not (data_dir / "rc_column").is_dir():
        pytest.skip("the loops of the column are not there")
    column = pmf.datasets.rc_column()
    model = declare(column["displacement"].values, column["force"].values)
    residuals, found = largest_residuals(model, (1.4e7, 0.015, 0.04, 0.04, 0.003, 0.79, 1.8e4))
    assert np.quantile(residuals, 0.95) < 1.5
    assert np.isnan(found["calibration"].attrs["growth"])
    assert float(found["sample_stats"]["evaluations"].sum()) == 300
