"""What 90 % intervals of damping contain, where identified damping ratios are the data.

Laboratories test a uniform chain of three storeys ten times each. Its modes are in closed form,
omega_j = 2 sqrt(k/m) sin((2j - 1) pi / 14) and zeta_j = alpha / (2 omega_j) + beta omega_j / 2, and share
nothing with the package. Each laboratory draws alpha and beta from the prior, an error of the model
of each mode, the same in all tests, and a scatter of each test. So the share of intervals that hold the truth
is 90 % exactly, if the posterior is right.
"""

import time

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
from pytensor.graph.replace import vectorize_graph

from benchmarks.tables import table
from pymc_features import ModalFeature, RayleighDamping, SpringMassChain, modes
from pymc_features.modal.feature import checked_parameters
from pymc_features.modal.identified import identified

RUNS, QUICK_RUNS = 1000, 50
N, TESTS = 3, 10  # storeys and modes; tests of a laboratory
MASS, STIFFNESS, MIDDLE = 1.0, 400.0, np.array([0.4, 1.5e-3])  # kg, N/m; alpha, beta [1/s, s] of the prior
WIDTH = 0.5  # standard deviations of the prior of ln alpha and ln beta
SIGMA = np.array([0.02, 0.2])  # error of the model in ln f and ln zeta
SCATTER = np.array([0.005, 0.15])  # of each test
POINTS = 61  # along each parameter, in four standard deviations about the middle of the prior


def chain_modes(alpha, beta) -> np.ndarray:
    """Frequencies [Hz] and damping ratios of the chain (2, mode), in closed form."""
    j = np.arange(1, N + 1)
    omega = 2.0 * np.sqrt(STIFFNESS / MASS) * np.sin((2 * j - 1) * np.pi / (2 * (2 * N + 1)))
    return np.array([omega / (2.0 * np.pi), 0.5 * (alpha / omega + beta * omega)])


def laboratory(rng) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of alpha and beta over the middle of the prior; frequencies and ratios (mode, test, 2)."""
    truth = WIDTH * rng.normal(size=2)
    errors = SIGMA * rng.normal(size=(N, 1, 2)) + SCATTER * rng.normal(size=(N, TESTS, 2))
    return truth, chain_modes(*MIDDLE * np.exp(truth)).T[:, None] * np.exp(errors)


def posterior_function(shared: bool = True):
    """Log-posterior (alpha, beta) on a grid, of the data of a laboratory, by the package; and the grid.

    With `shared` false, the negative control, each test has an error of the model of its own.
    """
    grid = WIDTH * np.linspace(-4.0, 4.0, POINTS)
    points = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    sigma, scatter = (SIGMA, SCATTER) if shared else (1e-9 * SIGMA, np.hypot(SIGMA, SCATTER))
    f, ratios = np.repeat(chain_modes(*MIDDLE), TESTS, axis=1)
    observed = {"frequencies": f, "frequency_sd": scatter[0] * f}
    observed |= {"damping_ratios": ratios, "damping_sd": scatter[1] * ratios}
    data = identified(observed, np.repeat(np.arange(N), TESTS), damping=True)
    x, value = pt.vector("x", shape=(2,)), pt.matrix("value", shape=data.values.shape)
    damping = RayleighDamping(*(middle * pt.exp(x[i]) for i, middle in enumerate(MIDDLE)))
    found = modes(SpringMassChain(np.full(N, MASS), STIFFNESS, damping))
    parameters = checked_parameters(found, data, sigma[0], None, "EXP", sigma[1])
    logp = pm.logp(ModalFeature.dist(*parameters), value).sum() - 0.5 * pt.sum(pt.sqr(x / WIDTH))
    many = pt.matrix("many", shape=(None, 2))
    function = pytensor.function([many, value], vectorize_graph(logp, {x: many}))
    return lambda data: function(points, data.reshape(N, -1)).reshape(POINTS, POINTS), grid


def coverage(runs: int, shared: bool = True, seed: int = 12) -> np.ndarray:
    """Share of the laboratories whose 90 % intervals of alpha and beta hold the truth."""
    log_posterior, grid = posterior_function(shared)
    rng, inside = np.random.default_rng(seed), []
    for _ in range(runs):
        truth, data = laboratory(rng)
        values = log_posterior(data)
        weights = np.exp(values - values.max())
        for at, density in zip(truth, (weights.sum(axis=1), weights.sum(axis=0)), strict=True):
            below = np.append(0.0, np.cumsum(0.5 * (density[1:] + density[:-1])))
            inside.append(0.05 <= np.interp(at, grid, below / below[-1]) <= 0.95)
    return np.reshape(inside, (-1, 2)).mean(axis=0)


def run_damping(quick=False):
    """Print the coverage of the two damping parameters."""
    runs, rows = QUICK_RUNS if quick else RUNS, []
    for what, shared in (("one for all tests of a mode", True), ("one for each test", False)):
        start = time.perf_counter()
        shares = coverage(runs, shared)
        rows.append(
            [what, *(f"{100.0 * share:.1f}" for share in shares), f"{time.perf_counter() - start:.0f}"]
        )
    print(f"## Damping ratios as data: {runs} laboratories\n")
    print(table(["error of the model", "alpha in 90 % [%]", "beta in 90 % [%]", "time [s]"], rows))
