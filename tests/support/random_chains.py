"""Arguments of the kernels of chains: a random structure, and populations."""

import numpy as np

from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.kernels import DAMPINGS


def random_chain(n, damping="rayleigh", quantity=0, **changes):
    """Arguments of `chain_response` for a random structure of n masses."""
    rng = np.random.default_rng(n)
    rayleigh, ratios = DAMPINGS[damping](n)
    arguments = {
        "mass": rng.uniform(0.5, 2.0, n),
        "stiffness": rng.uniform(30.0, 300.0, n) * n,
        "rayleigh": np.array(rayleigh),
        "ratios": np.array(ratios),
        "acceleration": rng.normal(size=changes.pop("n_times", 150)),
        "dt": 0.02,
        "substeps": 1,
        "stride": 1,
        "direct": NO_DIRECT,
        "sensors": np.arange(n),
        "n_modes": n,
    }
    assert changes.keys() <= arguments.keys()
    return [*(arguments | changes).values(), quantity]


def population(shared=()):
    """Arguments for five particles, with data and weights; parameters in `shared` have one row."""
    rng = np.random.default_rng(7)
    arguments = random_chain(3, "equal", quantity=2, sensors=np.array([2, 0]), stride=2)
    for i in range(4):
        arguments[i] = arguments[i] * rng.uniform(0.8, 1.2, (1 if i in shared else 5, arguments[i].size))
    return arguments, rng.normal(size=(2, 75)), rng.normal(size=(5, 2))
