"""What the likelihood of ambient vibration costs: a population's values, and its gradients, through PyMC.

Ten minutes at 50 Hz of a chain of eight storeys, all of them measured, in bands around its six lowest modes.
"""

import warnings

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds
from pymc_features.smc import population_logp

STOREYS, MODES, PARTICLES = 8, 6, 1000
STEP, SAMPLES, HALF_WIDTH = 0.02, 30_000, 0.06


def problem():
    """Stiffness of each storey, damping, forces and errors unknown."""
    rng = np.random.default_rng(0)
    f = (
        pmf.SpringMassChain(np.ones(STOREYS), 900.0, pmf.ModalDamping(0.01))
        .modes()
        .natural_frequencies[:MODES]
    )
    with pm.Model() as model, warnings.catch_warnings():
        warnings.simplefilter("ignore", pmf.exceptions.AmbientWarning)
        k = pm.LogNormal("k", np.log(900.0), 0.05, shape=STOREYS)
        chain = pmf.SpringMassChain(np.ones(STOREYS), k, pmf.ModalDamping(pm.LogNormal("zeta", -4.6, 0.2)))
        force, error = pm.LogNormal("force", 0.0, 1.0), pm.LogNormal("error", 0.0, 1.0)
        pmf.AmbientResponse(
            "y",
            pmf.ambient.spectral_response(chain, force, n_modes=MODES),
            error=error,
            bands=np.column_stack([f * (1.0 - HALF_WIDTH), f * (1.0 + HALF_WIDTH)]),
            dt=STEP,
            observed=rng.standard_normal((STOREYS, SAMPLES)),
        )
    return model


def run(quick=False):
    """Print the cost of a population, and of a particle of it."""
    model = problem()
    logp = population_logp(model, model.initial_point(), {})
    points = logp.start + 0.05 * np.random.default_rng(1).standard_normal((PARTICLES, logp.start.shape[1]))
    calls = {"value": lambda: logp(points), "value and gradient": lambda: logp.gradient(points)}
    seconds = best_of_rounds(calls, 2 if quick else 6)
    rows = [
        [name, f"{time:.2f}", significant(1e6 * time / PARTICLES), significant(time / seconds["value"])]
        for name, time in seconds.items()
    ]
    size = f"{PARTICLES} particles, {SAMPLES} samples, {STOREYS} channels, {MODES} modes"
    print(f"\n## Ambient vibration: {size}\n")
    print(table(["", "s", "us a particle", "x value"], rows))
