"""Parts of a posterior that a run misses: found, sampled, and said; and no alarm where nothing is missing."""

import functools
import warnings
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import stats

import pymc_features as pmf
from pymc_features.inference.cross_check import Effort, cross_check, tails_are_light
from pymc_features.smc.proposals.reference import Mode, Reference

QUIET = {"progressbar": False, "cores": 1, "chains": 2}


def mixture(weights, centres, scales, box, through=None):
    """Model of x (d,), uniform in +-box, with these parts; and its log evidence.

    The density goes `through` an Op, if one is given.
    """
    centres = np.array(centres, dtype=float)
    d = centres.shape[1]
    with pm.Model() as model:
        x = pm.Uniform("x", -box, box, shape=d)
        parts = [
            np.log(w) - 0.5 * ((x - c) ** 2).sum() / s**2 - d * np.log(s * np.sqrt(2.0 * np.pi))
            for w, c, s in zip(weights, centres, scales, strict=True)
        ]
        density = pt.logsumexp(pt.stack(parts))
        pm.Potential("parts", density if through is None else through(density))
    return model, -d * np.log(2.0 * box)


def spike(through=None):
    """Half of the mass in a part of a twentieth of the width of the other, and inside it."""
    return mixture([0.5, 0.5], [np.zeros(4), np.full(4, 0.75)], [1.0, 0.05], 8.0, through)


def sampled(model, draws=500, **settings):
    """Attributes of a run, and its draws."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pmf.exceptions.SamplingWarning)
        idata = pmf.sample(draws, model=model, **QUIET | settings)
    return idata["sample_stats"].attrs, idata["posterior"]["x"].values.reshape(
        -1, *idata["posterior"]["x"].shape[2:]
    )


@functools.cache
def of_spike(check):
    model, exact = spike()
    found, x = sampled(model, random_seed=1, check=check)
    return found, found["log_evidence"] - exact, x


def test_a_spike_is_missed_without_the_check():
    """The control: half of the evidence is missing, and nothing says so."""
    found, error, _ = of_spike(None)
    assert error == pytest.approx(-np.log(2.0), abs=0.1)
    assert found["advice"] == ""
    assert "check" not in found


def test_a_spike_is_found_and_sampled():
    """The share of the spike within 0.065: four standard errors of 1000 draws."""
    found, error, x = of_spike("standard")
    assert abs(error) < 0.1
    assert found["check_repeats"] == 1
    assert found["missed_share"] == 0.0
    assert found["advice"] == ""
    assert "found no other part" in found["check"]
    inside = (np.linalg.norm(x - 0.75, axis=1) < 0.25).mean()  # where the other has 3e-4
    assert inside == pytest.approx(0.5, abs=0.065)
    assert found["check_evaluations"] > 0
    assert found["check_gradients"] > 0


@pytest.mark.slow
def test_parts_that_few_climbs_find_are_sampled_or_warned_of():
    """Four parts of unequal width in three dimensions, one of which one in several hundred climbs finds."""
    centres = [[-5, -4, 3], [4, 5, -3], [0, -5, -5], [5, -3, 5]]
    model, exact = mixture([0.1, 0.2, 0.3, 0.4], centres, [0.8, 0.1, 0.4, 0.2], 12.0)
    found, _ = sampled(model, random_seed=1)
    assert abs(found["log_evidence"] - exact) < 0.15 or found["advice"]


class WithoutGradient(pytensor.graph.op.Op):
    """Identity of a scalar, without a gradient."""

    __props__ = ()
    itypes = otypes = [pt.dscalar]

    def perform(self, node, inputs, outputs):
        outputs[0][0] = np.asarray(inputs[0])


@pytest.mark.slow
def test_without_gradients_climbs_take_differences(monkeypatch):
    monkeypatch.setattr(import_module("pymc_features.inference.cross_check"), "THOROUGH", (12_000, 500))
    model, exact = spike(WithoutGradient())
    found, _ = sampled(model, random_seed=3, check="thorough")
    assert found["no_gradient"]
    assert abs(found["log_evidence"] - exact) < 0.1 or found["advice"]


def well_behaved():
    """Posteriors that `sample` gets right."""
    with pm.Model() as correlated:
        x = pm.Normal("x", 0.0, 3.0, shape=5)
        pm.Normal("y", x.cumsum(), 0.1, observed=np.arange(5.0))
    with pm.Model() as funnel:
        v = pm.Normal("v", 0.0, 1.0)
        pm.Normal("x", 0.0, pm.math.exp(v), shape=3)
    with pm.Model() as edge:
        x = pm.Uniform("x", 0.0, 1.0, shape=2)
        pm.Normal("y", x, 0.1, observed=[1.0, 0.0])
    with pm.Model() as tails:
        x = pm.StudentT("x", 3.0, shape=3)
        pm.Normal("y", x, 5.0, observed=np.zeros(3))
    return {"correlated": correlated, "funnel": funnel, "edge": edge, "tails": tails}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(well_behaved()))
def test_no_alarm_where_nothing_is_missing(name):
    """No alarm in two runs each. An alarm asks for a rise of the evidence of four standard errors."""
    for seed in (1, 2):
        found, _ = sampled(well_behaved()[name], random_seed=seed)
        assert found["check_repeats"] == 0, found["check"]
        assert "found no other part" in found["check"]
        assert "climbs" not in found["advice"]


@pytest.mark.parametrize("width, light", [(1.0, False), (0.7, True)])
def test_light_tails(width, light):
    """Draws of a normal distribution, right and too narrow, beside weighted ones of a wider distribution.

    Weights of ones from a much narrower distribution have no variance: nothing can be told.
    """
    rng = np.random.default_rng(1)
    draws, z = width * rng.standard_normal((2000, 3)), rng.standard_normal((5000, 3))
    for scale, expected in ((1.3, light), (0.4, None)):
        x = scale * z
        log_weights = (stats.norm.logpdf(x) - stats.norm.logpdf(x, scale=scale)).sum(axis=1)
        assert tails_are_light(log_weights, x, draws) is expected


def test_what_cannot_be_checked_is_said():
    with pm.Model() as model:
        n = pm.Poisson("x", 3.0)
        pm.Normal("y", n, 1.0, observed=4.0)
    found, _ = sampled(model, random_seed=1)
    assert found["check"] == "not done: the model has discrete parameters"

    with pytest.raises(ValueError, match="`check` must be one of standard, thorough"):
        pmf.sample(100, model=spike()[0], check="all", **QUIET)


def test_evidence_of_a_mode_is_that_of_laplace():
    """Exact for a normal posterior, whatever the scale of the prior."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, [10.0, 0.1])
        pm.Normal("y", x, 1.0, observed=[3.0, 0.5])
    idata = pmf.sample(100, model=model, random_seed=1, check=None, **QUIET)
    exact = stats.norm([0.0, 0.0], np.sqrt([101.0, 1.01])).logpdf([3.0, 0.5]).sum()
    assert float(idata["modes"]["log_evidence"][0]) == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("log_weight", [-12.0, -40.0])
def test_what_is_negligible_is_looked_at_once(log_weight):
    """A hundred climbs end at one minor mode, whose curvature is taken once: two calls of 2 d gradients."""
    rng, asked, d = np.random.default_rng(1), [], 7

    def parts(x):
        away = x - np.array([np.zeros((1, d)), np.full((1, d), 6.0)])
        return np.array([[0.0], [log_weight]]) - 0.5 * (away**2).sum(axis=2) - 0.5 * d * np.log(
            2.0 * np.pi
        ), away

    def gradients(x):
        asked.append(len(x))
        logs, away = parts(x)
        shares = np.exp(logs - np.logaddexp(*logs))[:, :, None]
        return np.logaddexp(*logs), -(shares * away).sum(axis=0)

    density = SimpleNamespace(
        values=lambda x: np.logaddexp(*parts(x)[0]),
        gradients=gradients,
        has_gradient=True,
        draw_prior=lambda n: rng.uniform(5.0, 7.0, (n, d)),
    )
    found = cross_check(density, rng.standard_normal((500, d)), 0.0, 0.01, Effort(500, 100), rng)
    assert not found.missed
    assert asked.count(2 * d) < 10


@pytest.mark.parametrize(("around", "rare"), [([6.0], True), ([0.0, 6.0], False)])
def test_a_heavy_mode_that_few_climbs_lead_to_leaves_doubt(around, rare):
    """The run knows both halves of the posterior, and nothing is missed: but who knows what else there is."""
    rng, centres = np.random.default_rng(2), np.array([np.zeros((1, 2)), np.full((1, 2), 6.0)])

    def gradients(x):
        away = x - centres
        logs = np.log(0.25 / np.pi) - 0.5 * (away**2).sum(axis=2)
        shares = np.exp(logs - np.logaddexp(*logs))[:, :, None]
        return np.logaddexp(*logs), -(shares * away).sum(axis=0)

    modes = [Mode(centre[0], np.eye(2), np.log(0.5), 1) for centre in centres]
    draws = rng.standard_normal((500, 2)) + np.repeat(centres[:, 0], 250, axis=0)
    prior = SimpleNamespace(
        values=lambda x: gradients(x)[0],
        gradients=gradients,
        has_gradient=True,
        draw_prior=lambda n: rng.choice(around, (n, 1)) + rng.uniform(-0.5, 0.5, (n, 2)),
    )
    reference = Reference(modes, np.zeros(2), np.ones(2))
    found = cross_check(prior, draws, 0.0, 0.01, Effort(500, 100), rng, reference)
    assert not found.missed
    assert found.rare == rare
    assert ("less than 2 % of climbs" in found.advice(found.rare)) == rare
