"""What the refinement of a band-limited record costs: `python -m benchmarks.refined`.

Value, gradient and a population of TN, of records whose sampling asks for no refinement, for two and for
four, beside the same record joined by straight lines; ratios, measured in turns.
"""

import warnings
from typing import NamedTuple

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.__main__ import confine, environment
from benchmarks.tables import table
from benchmarks.timing import best_of_rounds
from pymc_features.smc import population_logp
from pymc_features.study import paper

KINDS = ("linear", "band-limited")
SHARES = {1: 0.02, 2: 0.1, 4: 0.4}  # refinement: highest natural frequency over the sampling rate
LENGTHS = (500, 1500, 6000)  # samples
PARTICLES, ROUNDS = 256, 8


class Family(NamedTuple):
    """A structure (function of a factor on its springs) and its highest natural frequency [Hz]."""

    structure: object
    highest: float


def families() -> dict[str, Family]:
    """Ten storeys of the source, and three that yield."""
    chain, damping = paper.chain(), pmf.RayleighDamping(0.2, 1e-4)

    def hysteretic(theta):
        springs = {"yield_displacement": 0.01, "post_yield_ratio": 0.1}
        return pmf.HystereticChain(np.ones(3), 900.0 * theta * np.ones(3), damping, **springs)

    def scaled(theta):
        return chain.scale_stiffness([theta], springs=[0])

    small = pmf.SpringMassChain(np.ones(3), 900.0 * np.ones(3), damping)
    return {
        "chain of ten": Family(scaled, chain.modes().natural_frequencies[-1]),
        "three that yield": Family(hysteretic, small.modes().natural_frequencies[-1]),
    }


def calls(family, dt, n_times, kind):
    """Value, gradient and population of one model, as calls without arguments."""
    rng = np.random.default_rng(0)
    record = pmf.Record(rng.standard_normal(n_times), dt, interpolation=kind)
    with pm.Model() as model:
        theta = pm.LogNormal("theta", 0.0, 0.05)
        mu = pmf.response(family.structure(theta), record, dt=dt)
        data = rng.standard_normal((mu.type.shape[0] or int(mu.shape[0].eval()), n_times))
        pmf.TruncNormalFeature("y", mu, 1.0, observed=data)
    value, gradient = model.compile_logp(), model.compile_dlogp()
    population = population_logp(model, model.initial_point(), {})
    point, many = {"theta_log__": np.array(0.01)}, rng.normal(0.0, 0.02, (PARTICLES, 1))
    return {
        "value": lambda: value(point),
        "gradient": lambda: gradient(point),
        "population": lambda: population(many),
    }


def main():
    """Print the ratios."""
    warnings.filterwarnings("ignore")
    confine()
    print(environment())
    rows = []
    for name, family in families().items():
        for factor, share in SHARES.items():
            for n_times in LENGTHS[: 3 if name.startswith("chain") else 1]:
                dt = share / family.highest
                by_kind = {kind: calls(family, dt, n_times, kind) for kind in KINDS}
                cells = []
                for what in by_kind["linear"]:
                    seconds = best_of_rounds({kind: by_kind[kind][what] for kind in KINDS}, ROUNDS)
                    cells.append(f"{seconds['band-limited'] / seconds['linear']:.2f}")
                rows.append([name, str(factor), f"{n_times}", *cells])
    headers = ["structure", "refined", "samples", "value", "gradient", f"population of {PARTICLES}"]
    print("Cost over that of straight lines between the samples\n\n" + table(headers, rows))


if __name__ == "__main__":
    main()
