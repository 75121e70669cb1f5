"""Cyclic tests of a specimen: what calibrated intervals contain, without and with blocks of cycles compared.

Where structures have natural frequencies, frequency bands that disagree about the parameters make intervals
wider. A specimen has none; blocks of its record could take their place. Each event is another path; errors of
2 % persist for five samples. The value sought is the one that fits all events best. Truth by
`benchmarks.truth`.
"""

import time

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.errors import first_order
from benchmarks.tables import table
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Predictions
from pymc_features.calibration.sandwich import LARGEST, Peak, error_model, growth_of, whitening

EVENTS, QUICK_EVENTS = 200, 8
N_PARAMETERS, BLOCKS, LEVEL, WIDE = 4, (2, 3, 5), 4e3, 1.645  # N, standard deviations of 90 %
LAW = np.array([2e7, 0.008, 0.05, 2.0, 0.5, 0.5, 0.0, 0.03, 0.7, 1.0, 0.1, 0.3, 0.0, 0.3])
START = np.log([2e7, 0.008, 0.7 / 0.25, 0.03, LEVEL])  # unconstrained
TRUTHS = {
    "right model": {},
    "sharpness 1.2, not 2": {3: 1.2},
    "loops of another shape": {4: 0.8, 5: 0.2},
    "strength degrades": {6: 0.03},
    "pinching that spreads": {12: 0.05},
    "slack of 0.4 mm": {},
}


def declare(displacement, force):
    """Stiffness, yield displacement, slip and degradation of a specimen."""
    with pm.Model() as model:
        k, reach = pm.LogNormal("k", 16.8, 0.4), pm.LogNormal("d_y", -4.8, 0.4)
        slip, degradation = pm.Uniform("slip", 0.0, 0.95), pm.HalfNormal("delta_eta", 0.1)
        specimen = pmf.structures.HystereticSpecimen(
            k,
            yield_displacement=reach,
            post_yield_ratio=0.05,
            degradation=pmf.structures.Degradation(stiffness=degradation),
            pinching=pmf.structures.Pinching(slip, spread=0.3),
        )
        mu = pmf.response(specimen, pmf.structures.CyclicTest(displacement))
        pm.Normal("force", mu, pm.HalfNormal("sigma", 3e4), observed=force[None])
    return model


def in_blocks(event, n):
    """The error model of an event with blocks of its record in place of bands."""
    whiten, models, informations = whitening(event.of_response), [], []
    scores, ends = [], np.linspace(0, event.residuals.shape[1], n + 1).astype(int)
    for first, last in zip(ends, ends[1:], strict=False):
        own = np.zeros_like(event.sensitivities)
        own[:, first:last] = event.sensitivities[:, first:last]
        models.append(error_model(event.residuals, own, event.mu, whiten=whiten))
        scores.append(np.einsum("stp,st->p", own, event.residuals))
        informations.append(np.einsum("stp,stq->pq", own, own))
    variabilities = np.array([model.variability for model in models])
    return models[0]._replace(
        scores=np.array(scores), variabilities=variabilities, informations=np.array(informations)
    )


def outcome(name, seed):
    """Maximum (p,), standard deviations (p,), and the growth by each number of blocks, of one event."""
    rng, law = np.random.default_rng([17, seed]), LAW.copy()
    for place, value in TRUTHS[name].items():
        law[place] = value
    n = 3 + rng.integers(4)
    peaks = np.repeat(np.arange(1, n + 1), 2) * np.tile([1.0, -1.0], n) * rng.uniform(0.8, 1.2)
    displacement = truth.cycles(0.008, peaks, 50)
    slack = 4e-4 * np.sign(np.gradient(displacement)) if name.startswith("slack") else 0.0
    force = truth.specimen_force(law, displacement + slack, rtol=1e-8)
    force = force + LEVEL * first_order(rng, (1, force.size), 1.0, 5.0)[0]
    fit = climb_likelihood(Predictions(declare(displacement, force)), START)
    sd = np.sqrt(np.diag(Peak.at(fit).covariance))
    growth = [growth_of([in_blocks(fit.events[0], n)], N_PARAMETERS) for n in BLOCKS]
    return fit.z[:N_PARAMETERS], sd[:N_PARAMETERS], np.fmin(np.fmax(growth, 1.0), LARGEST)


def run_cyclic(quick=False):
    """Print coverage of the best value, without blocks and with them, and by how much these widen."""
    n, start, rows = QUICK_EVENTS if quick else EVENTS, time.perf_counter(), []
    for name in TRUTHS:
        maxima, sd, growth = map(np.array, zip(*(outcome(name, seed) for seed in range(n)), strict=True))
        best = START[:N_PARAMETERS] if name == "right model" else np.median(maxima, axis=0)
        off, cells = np.abs(maxima - best) / sd / WIDE, []
        for factor in (np.ones(n), *growth.T):
            inside = 100.0 * np.mean(off < factor[:, None], axis=0)
            cells.append(f"{inside.mean():.0f} ({inside.min():.0f}); {np.median(factor):.2f}")
        rows.append([name, *cells])
        print(" | ".join(rows[-1]), flush=True)
    print(
        f"\n## Cyclic tests: {n} events each, {time.perf_counter() - start:.0f} s\n\n"
        "How many of 100 intervals contain the best value (lowest parameter); the median factor.\n"
    )
    print(table(("truth", "no blocks", *(f"{k} blocks" for k in BLOCKS)), rows))
