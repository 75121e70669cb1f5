"""CAL in the study: its exact posterior, its width against the sampling step, and what it is made from."""

import numpy as np
import pytest

from pymc_features import sampling_rate_study
from pymc_features.study import sampling_rate as study_module
from pymc_features.study.exact import DiscrepancyCurve, Exponents, Stretch, exact_posterior, reference
from pymc_features.study.settings import Study
from support.straight import Record

pytestmark = pytest.mark.slow

STEPS = (0.2, 1.0)  # over that of the record


def widths(record, kind, seed=0, **settings):
    """Exact 5-95 % width of theta at two sampling steps."""
    study = Study(record, random_seed=seed, multipliers=STEPS, **settings)
    rows = [reference(kind, study.misfit(m)).statistics[0] for m in STEPS]
    return np.array([row[3] - row[1] for row in rows])


def test_of_errors_that_persist_the_width_does_not_depend_on_the_sampling_rate(record):
    """A fifth of the step: 10 %. NORM, which does not look at its residuals, is the control.

    What is right for these errors is CN, which knows their correlation, and weighs the data better for it.
    """
    settings = {"noise_time": 0.05, "seed": 4}  # noise about which frequency bands agree
    calibrated, norm, known = (widths(record, kind, **settings) for kind in ("CAL", "NORM", "CN"))
    assert calibrated[0] == pytest.approx(calibrated[1], rel=0.1)
    assert norm[0] < 0.5 * norm[1]
    assert ((calibrated > 0.9 * known) & (calibrated < 1.5 * known)).all()


def test_of_white_errors_it_is_that_of_norm(record):
    """Every sample is new then; one estimate of a variability is right to some 20 %."""
    np.testing.assert_allclose(widths(record, "CAL"), widths(record, "NORM"), rtol=0.25)


def test_a_stretch_and_its_inverse():
    stretch = Stretch((0.5, 1.5), 0.9, 2.5)
    y = np.linspace(0.55, 1.45, 9)
    x = stretch.inside(y)
    back, slope = stretch.outside(x)
    np.testing.assert_allclose(back, y, rtol=1e-12)
    np.testing.assert_allclose(slope, 2e-6 / (stretch.inside(y + 1e-6) - stretch.inside(y - 1e-6)), rtol=1e-6)
    assert stretch.inside(0.9) == pytest.approx(0.9)
    ends, slope = stretch.outside(np.array([0.5, 1.5]))
    np.testing.assert_allclose(ends, [0.5, 1.5])
    np.testing.assert_allclose(slope, 0.0)


def test_quadrature_of_a_stretched_likelihood_against_sums_on_a_fine_grid():
    """The same density, summed in the parameters themselves: quantiles and evidence."""
    minimum, curvature, centre = 0.07, 300.0, 1.01
    curve = DiscrepancyCurve(lambda t: minimum + curvature * (t - centre) ** 2, (0.5, 1.5), 40)
    likelihood = Exponents(25.0, 20.0, -3.0)
    best = np.sqrt(likelihood.c * minimum / likelihood.m)
    stretches = Stretch((0.5, 1.5), centre, 0.6), Stretch((0.0, 2.0), best, 1.0 / 0.6)
    found = exact_posterior(curve, likelihood, (0.0, 2.0), stretches)
    theta, sigma = ((np.arange(2000) + 0.5) / 2000 + 0.5, (np.arange(2000) + 0.5) / 1000)
    x, s = stretches[0].inside(theta)[:, None], stretches[1].inside(sigma)
    total = minimum + curvature * (x - centre) ** 2
    mass = np.exp(-likelihood.m * np.log(s) - likelihood.c * total / (2 * s**2))
    assert found.log_evidence == pytest.approx(np.log(mass.mean()) - 3.0, abs=1e-5)
    for nodes, marginal, of in (
        (theta, found.theta, mass.sum(axis=1)),
        (sigma, found.sigma, mass.sum(axis=0)),
    ):
        below = (np.cumsum(of) - 0.5 * of) / of.sum()
        expected = np.interp([0.05, 0.5, 0.95], below, nodes)
        np.testing.assert_allclose(marginal.quantile([0.05, 0.5, 0.95]), expected, rtol=1e-4)
    assert found.map == pytest.approx((centre, best))


def test_what_it_is_made_from_is_sampled_and_kept(tmp_path, monkeypatch):
    """CAL alone: NORM is no part of the result, and is not sampled twice."""
    record = Record(np.random.default_rng(11).normal(size=150), 0.02, name="short")
    settings = {"multipliers": (1.0,), "draws": 400, "chains": 1, "random_seed": 0, "progressbar": False}
    settings |= {"likelihoods": ["CAL"], "out": tmp_path, "cores": 1}
    result = sampling_rate_study(record, **settings)
    assert result["summary"]["likelihood"].values.tolist() == ["CAL"]
    assert "NORM" not in result.children
    summary = result["summary"].to_dataset().isel(likelihood=0, multiplier=0)
    exact = summary["exact"].sel(parameter=["theta", "sigma"])
    off = summary["sampled"] - exact
    # 400 draws: the standard error of the worst quantile is 4 % of the width
    quantiles = off.sel(statistic=["q05", "q50", "q95"]) / (
        exact.sel(statistic="q95") - exact.sel(statistic="q05")
    )
    assert float(abs(quantiles).max()) < 0.16
    assert 0 < result["CAL/x1/calibration"].attrs["n_eff"] < 2.0 * 10 * 150
    run, called = study_module.run_part, []

    def listed(study, kind, *rest):
        called.append(kind)
        return run(study, kind, *rest)

    (tmp_path / "parts" / "CAL_x1.nc").unlink()
    monkeypatch.setattr(study_module, "run_part", listed)
    again = sampling_rate_study(record, **settings)
    assert called == ["CAL"]
    np.testing.assert_array_equal(again["CAL/x1/posterior"]["theta"], result["CAL/x1/posterior"]["theta"])
