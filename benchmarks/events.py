"""Several events: what they cost in one model, and how near two-stage and sequential answers are.

Parts (`--names`): records, the cost of three records in one model beside that of each (a minute); joint,
three earthquakes by `hierarchical` and by NUTS on a joint model (ten minutes); sequence, ten events one
after another beside the exact answer of all (a minute); drift, a storey that loses a tenth of its stiffness
at event six of ten, and sound structures (an hour).
"""

import logging
from time import thread_time

import numpy as np
import pymc as pm
from scipy.stats import multivariate_normal

import pymc_features as pmf
from pymc_features.smc import population_logp

LEVELS = [0.05, 0.5, 0.95]
QUIET = {"cores": 1, "progressbar": False}


def chain(theta, n=3, stiffness=1000.0):
    """A chain whose stiffnesses have a common factor, or one each."""
    return pmf.SpringMassChain(np.ones(n), stiffness * np.ones(n) * theta, pmf.ModalDamping(0.03))


def apart(a, b):
    """Largest difference of quantiles of two samples, over the width of the second."""
    a, b = np.quantile(a, LEVELS), np.quantile(b, LEVELS)
    return np.abs(a - b).max() / (b[2] - b[0])


# ---- several records in one model ----


def simulated(seed, dt, duration, n, sensors=None):
    """A record, and measured floors with errors of a fifth of the rms."""
    record, rng = (
        pmf.synthetic_earthquake(duration, dt, random_seed=seed, pga=2.0),
        np.random.default_rng(seed),
    )
    floors = pmf.simulate(chain(1.0, n), record, sensors=sensors).values
    return record, floors + 0.2 * floors.std() * rng.normal(size=floors.shape)


def model_of(events, shared):
    """One model of some records of a ten-storey chain."""
    with pm.Model() as model:
        sigma, mean = pm.HalfNormal("sigma", 1.0), pm.Normal("mean", 1.0, 0.1)
        theta = [mean] * len(events) if shared else pm.Normal("theta", mean, 0.05, shape=len(events))
        for i, (record, measured) in enumerate(events):
            pmf.ExpFeature(f"y{i}", pmf.response(chain(theta[i], 10), record), sigma, observed=measured)
    return model


def records():
    """Time of 500 particles, values and gradients: medians, in turns."""
    events = [simulated(i, dt, t, 10) for i, (dt, t) in enumerate([(0.02, 8.0), (0.01, 6.0), (0.02, 12.0)])]
    models = {f"event {i}": model_of([event], True) for i, event in enumerate(events)}
    models |= {"all, one factor": model_of(events, True), "all, one each": model_of(events, False)}
    logps, points, times = {}, {}, {}
    for name, model in models.items():
        start = thread_time()
        logps[name] = population_logp(model, model.initial_point(), {})
        logps[name].compile_gradient()
        print(f"{name:16s} compiled in {thread_time() - start:.1f} s")
        x = np.concatenate([np.ravel(v) for v in model.initial_point().values()])
        points[name] = x + 0.01 * np.random.default_rng(1).normal(size=(500, len(x)))
        times[name] = []
    for _ in range(15):
        for name, logp in logps.items():
            start = thread_time()
            logp(points[name])
            middle = thread_time()
            logp.gradient(points[name])
            times[name].append((middle - start, thread_time() - middle))
    medians = {name: np.median(values, axis=0) for name, values in times.items()}
    parts = sum(medians[f"event {i}"] for i in range(3))
    for name, values in medians.items():
        print(
            f"{name:16s} value {1e3 * values[0]:6.1f} ms, gradient {1e3 * values[1]:6.1f} ms, "
            f"over the sum of the parts {values[0] / parts[0]:.2f}, {values[1] / parts[1]:.2f}"
        )


# ---- two stages, and one ----


def joint():
    """Quantiles of mean, scatter and single events, and the evidence."""
    rng = np.random.default_rng(7)
    factors, events = 1.0 + 0.06 * rng.normal(size=3), []
    for i, factor in enumerate(factors):
        record = pmf.synthetic_earthquake(8.0, 0.02, random_seed=i, pga=2.0)
        y = pmf.simulate(chain(factor), record, sensors=[0, 2]).values
        events.append((record, y + 0.5 * y.std() * rng.normal(size=y.shape)))

    def likelihood(name, theta, i):
        record, measured = events[i]
        mu = pmf.response(chain(theta), record, sensors=[0, 2])
        pmf.ExpFeature(name, mu, pm.HalfNormal(f"sigma_{name}", 2.0), observed=measured)

    def population():
        return pm.Normal("mean", 1.0, 0.3), pm.HalfNormal("scatter", 0.1)

    models = []
    for i in range(3):
        with pm.Model() as model:
            likelihood("y", pm.Uniform("theta", 0.3, 2.0), i)
        models.append(model)
    posteriors = [pmf.sample(4000, model=m, chains=2, random_seed=i, **QUIET) for i, m in enumerate(models)]
    with pm.Model() as hyper:
        pm.Normal("theta", *population())
    settings = {"draws": 8000, "chains": 2, "random_seed": 1, **QUIET}
    two = pmf.hierarchical(posteriors, hyper, models=models, event_draws=8000, **settings)
    with pm.Model() as whole:
        mean, scatter = population()  # by standard normal variables, which NUTS can sample
        theta = pm.Deterministic("theta", mean + scatter * pm.Normal("z", shape=3))
        for i in range(3):
            likelihood(f"y{i}", theta[i], i)
        one = pm.sample(10_000, tune=1500, chains=2, random_seed=1, target_accept=0.95, **QUIET)
    for name in ("mean", "scatter"):
        print(f"{name}: off by {apart(two.posterior[name], one.posterior[name]):.3f} of the width")
    for i in range(3):
        print(f"event {i}: {apart(two.events.theta.sel(event=i), one.posterior.theta[..., i]):.3f}")
    exact = pmf.sample(1000, model=whole, random_seed=1, **QUIET).sample_stats.attrs
    found = two.sample_stats.attrs
    print(
        f"log evidence {found['log_evidence']:.3f} +- {found['log_evidence_se']:.3f}; joint model "
        f"{exact['log_evidence']:.3f} +- {exact['log_evidence_se']:.3f}"
    )


# ---- one after another ----


def sequence():
    """Ten events of a linear model with three parameters: quantiles, scores and evaluations."""
    rng, noise, prior = np.random.default_rng(5), 0.5, 3.0
    design = rng.normal(size=(10, 6, 3))
    data = design @ np.array([1.0, -0.5, 2.0]) + noise * rng.normal(size=(10, 6))
    with pm.Model() as model:
        a, y = pm.Data("a", design[0]), pm.Data("y", data[0])
        pm.Normal("obs", a @ pm.Normal("theta", 0.0, prior, shape=3), noise, observed=y)
    idata, precision, moment = None, np.eye(3) / prior**2, np.zeros(3)
    for i in range(10):
        pm.set_data({"a": design[i], "y": data[i]}, model=model)
        settings = {"model": model, "random_seed": i, **QUIET}
        idata = (
            pmf.sample(4000, chains=2, **settings) if i == 0 else pmf.events.continue_with(idata, **settings)
        )
        precision, moment = (
            precision + design[i].T @ design[i] / noise**2,
            moment + design[i].T @ data[i] / noise**2,
        )
        covariance = np.linalg.inv(precision)
        exact = covariance @ moment + np.sqrt(np.diag(covariance)) * 1.6449 * np.array([[-1.0], [0.0], [1.0]])
        found = idata.posterior["theta"].quantile(LEVELS, dim=("chain", "draw")).values
        off = np.abs((found - exact) / (exact[2] - exact[0])).max()
        count = int(idata.sample_stats["evaluations"].sum())
        print(f"event {i}: quantiles off by {off:.3f} of the width, {count} evaluations")
    flat = design.reshape(-1, 3)
    batch = multivariate_normal.logpdf(data.ravel(), cov=noise**2 * np.eye(60) + prior**2 * flat @ flat.T)
    scores = idata["sequence"]
    print(
        f"scores add up to {float(scores.log_score.sum()):.3f} +- {float(scores.log_score_se.sum()):.3f}, "
        f"all at once {batch:.3f}"
    )


def drift(n_structures=20):
    """Alarms of structures that lose a tenth of one storey's stiffness at event six, and of sound ones."""
    record = pmf.synthetic_earthquake(6.0, 0.02, random_seed=1, pga=1.0)
    clean = pmf.simulate(chain(1.0), record, sensors=[0, 2]).values
    noise = 0.2 * clean.std()
    with pm.Model() as model:
        measured, theta = pm.Data("measured", clean), pm.Uniform("theta", 0.5, 1.5, shape=3)
        pm.Normal("y", pmf.response(chain(theta), record, sensors=[0, 2]), noise, observed=measured)
    for damaged in (True, False):
        for k in range(n_structures):
            rng, events = np.random.default_rng([k, int(damaged)]), []
            true, storey = rng.uniform(0.8, 1.2, 3), rng.integers(3)
            for e in range(10 if damaged else 11):
                now = np.where((np.arange(3) == storey) & damaged & (e >= 5), 0.9, 1.0) * true
                floors = pmf.simulate(chain(now), record, sensors=[0, 2]).values
                events.append({"measured": floors + noise * rng.normal(size=clean.shape)})
            state = pmf.events.sample_in_sequence(events, model=model, draws=400, random_seed=0, **QUIET)
            print("damaged" if damaged else "sound", k, state["sequence"]["alarm"].values, flush=True)


PARTS = {"records": records, "joint": joint, "sequence": sequence, "drift": drift}


def run(quick=False, names=None):
    """Run the parts asked for; all but the longest by default, two of them if it is to be quick."""
    logging.getLogger("pymc").setLevel(logging.ERROR)
    for name in names or (("records", "sequence") if quick else ("records", "joint", "sequence")):
        print(f"\n## {name}")
        PARTS[name]()
