"""Cost of one log-likelihood, as ratios measured side by side in one run.

    python benchmarks/likelihood.py

Ten storeys, ten sensors, 1559 samples. Compared: TN through the fused Op; TN through the stored response;
the conventional Gaussian on the stored response; and what people write today, a black-box Op around
`scipy.signal.dlsim` in front of `pm.Normal`.
"""

import time

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from scipy.signal import cont2discrete, dlsim

import pymc_features as pmf

REPEATS = 7


class BlackBox(Op):
    """Response by SciPy: state space, first-order hold, one call for each evaluation."""

    def __init__(self, record):
        self.record = record

    def make_node(self, theta):
        return Apply(self, [pt.as_tensor_variable(theta)], [pt.matrix(dtype="float64")])

    def perform(self, node, inputs, output_storage):
        mass, damping, stiffness = pmf.paper.chain(float(inputs[0])).matrices()
        n = len(mass)
        drift = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
        a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), drift])
        b = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
        system = cont2discrete((a, b, drift, np.zeros((n, 1))), self.record.dt, method="foh")
        _, output, _ = dlsim(system, self.record.acceleration)
        output_storage[0][0] = output.T


def declare(kind, record, data):
    """One of the models compared."""
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        sigma = pm.Uniform("sigma", 0.0, 2.0)
        mu = BlackBox(record)(theta) if kind == "black box" else pmf.response(pmf.paper.chain(theta), record)
        if kind == "TN, fused":
            pmf.TruncNormalFeature("y", mu=mu, sigma=sigma, observed=data)
        elif kind == "TN, stored":
            pmf.TruncNormalFeature("y", mu=mu + 0.0 * theta, sigma=sigma, observed=data)
        else:
            pm.Normal("y", mu=mu, sigma=sigma, observed=data)
    return model


def main():
    """Print microseconds, best of several rounds, and ratios to the first."""
    record = pmf.synthetic_earthquake(31.16, 0.02, seed=1940, pga=3.13)
    data = pmf.paper.measurements(record, multipliers=(1.0,)).values
    functions, point = {}, None
    for kind in ("TN, fused", "TN, stored", "NORM, stored", "black box"):
        model = declare(kind, record, data)
        functions[kind], point = model.compile_logp(), model.initial_point()
        functions[kind](point)
    best = dict.fromkeys(functions, np.inf)
    for _ in range(REPEATS):  # interleaved, so that a busy machine is unfair to all alike
        for kind, logp in functions.items():
            calls = 3 if kind == "black box" else 100
            start = time.perf_counter()
            for _ in range(calls):
                logp(point)
            best[kind] = min(best[kind], (time.perf_counter() - start) / calls)
    first = best["TN, fused"]
    for kind, seconds in best.items():
        print(f"{kind:14s} {1e6 * seconds:10.1f} us {seconds / first:8.1f} x")


if __name__ == "__main__":
    main()
