"""What an exact gradient costs: value and gradient together over the value alone.

Through PyMC (log-posterior of TN, springs unknown), where a sampler uses it, and of the kernels themselves;
beside central differences, which grow with the number of parameters, and JAX. Then of whole populations, for
families of structures.
"""

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.case import ALPHA, BETA, record_of_length
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds
from pymc_features.smc import population_logp

# number of unknown springs -> degrees of freedom; ten sensors each, and one for each storey of the largest
SIZES = ((1, 10, 10), (10, 10, 10), (100, 100, 10), (100, 100, 100))
SAMPLES = 1559
PARTICLES = 200
POPULATIONS = (
    *(("chain", 10), ("matrices", 10), ("Bouc-Wen", 10), ("Duffing", 10)),
    *(("chain", 40), ("matrices", 40), ("Bouc-Wen", 40), ("Duffing", 40)),
)
NONLINEAR = {
    "Bouc-Wen": (pmf.HystereticChain, {"yield_displacement": 0.05, "post_yield_ratio": 0.1}),
    "Duffing": (pmf.DuffingChain, {"cubic": 1e4}),
}


def problem(n_parameters, n_dof, n_sensors):
    """Log-posterior of a chain whose first springs are unknown, and its data."""
    record = record_of_length(SAMPLES)
    sensors = np.linspace(0, n_dof - 1, n_sensors).astype(int)
    nominal = pmf.SpringMassChain(np.ones(n_dof), np.full(n_dof, 1800.0), pmf.RayleighDamping(ALPHA, BETA))
    response = pmf.simulate(nominal, record, sensors=sensors).values
    data = response + 0.05 * response.std() * np.random.default_rng(0).normal(size=response.shape)
    with pm.Model() as model:
        k = pm.Lognormal("k", 0.0, 0.1, shape=n_parameters)
        sigma = pm.HalfNormal("sigma", 1.0)
        stiffness = pm.math.concatenate([1800.0 * k, np.full(n_dof - n_parameters, 1800.0)])
        chain = pmf.SpringMassChain(np.ones(n_dof), stiffness, pmf.RayleighDamping(ALPHA, BETA))
        pmf.TruncNormalFeature(
            "y", mu=pmf.response(chain, record, sensors=sensors), sigma=sigma, observed=data
        )
    return model


def calls(model):
    """Value, and value and gradient, of a model's log-posterior, in Numba and in JAX where it is there."""
    value = model.compile_fn(model.logp(), inputs=model.value_vars, point_fn=False)
    both = model.logp_dlogp_function(ravel_inputs=True)
    both.set_extra_values({})
    n = sum(v.type.shape[0] if v.ndim else 1 for v in model.value_vars)
    x = np.full(n, -0.01)
    point = [x[:-1], x[-1]]
    found = {"value": lambda: value(*point), "value and gradient": lambda: both(x)}
    try:
        import jax
        from pymc.sampling.jax import get_jaxified_logp
    except ImportError:
        return found
    logp = get_jaxified_logp(model)
    in_jax, gradient_in_jax = jax.jit(logp), jax.jit(jax.value_and_grad(lambda p: logp(p)))
    found["JAX value"] = lambda: jax.block_until_ready(in_jax(point))
    found["JAX value and gradient"] = lambda: jax.block_until_ready(gradient_in_jax(point))
    return found


def structure(kind, n_dof, x):
    """Unit masses on springs of 1800 N/m, those of the lower and of the upper half scaled by x (2,)."""
    mass, damping, half = np.ones(n_dof), pmf.RayleighDamping(ALPHA, BETA), n_dof // 2
    if kind == "matrices":
        drifts = np.eye(n_dof) - np.eye(n_dof, k=-1)
        terms = [1800.0 * d.T @ d for d in (drifts[:half], drifts[half:])]
        nothing = np.zeros((n_dof, n_dof))
        return pmf.AffineStructure(mass, stiffness=nothing, damping=damping, stiffness_terms=terms, theta=x)
    make, more = NONLINEAR.get(kind, (pmf.SpringMassChain, {}))
    return make(mass, x @ (1800.0 * np.repeat(np.eye(2), half, axis=1)), damping, **more)


def population_calls(kind, n_dof):
    """Values, and values and gradients, of all particles; the same of one after the other."""
    record = record_of_length(SAMPLES)
    sensors = np.linspace(0, n_dof - 1, 10).astype(int)
    exact = pmf.simulate(structure(kind, n_dof, np.ones(2)), record, sensors=sensors).values
    data = exact + 0.05 * exact.std() * np.random.default_rng(0).normal(size=exact.shape)
    with pm.Model() as model:
        x = pm.Lognormal("x", 0.0, 0.1, shape=2)
        mu = pmf.response(structure(kind, n_dof, x), record, sensors=sensors)
        pmf.TruncNormalFeature("y", mu, pm.HalfNormal("sigma", 1.0), observed=data)
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(1).normal(0.0, 0.1, (PARTICLES, 3))
    both = model.logp_dlogp_function(ravel_inputs=True)
    both.set_extra_values({})
    return {
        "values": lambda: logp(particles),
        "gradients": lambda: logp.gradient(particles),
        "one by one": lambda: [both(row) for row in particles],
    }


def run_populations(quick):
    """Print the table of populations."""
    rows, chains = [], {}
    for kind, n_dof in POPULATIONS[:2] if quick else POPULATIONS:
        seconds = best_of_rounds(population_calls(kind, n_dof), rounds=1 if quick else 3)
        us = {name: 1e6 * s / PARTICLES for name, s in seconds.items()}
        if kind == "chain":
            chains[n_dof] = us["gradients"]
        relative = us["gradients"] / chains[n_dof]
        ratios = (us["gradients"] / us["values"], us["one by one"] / us["gradients"], relative)
        rows.append([f"{kind}, {n_dof} DOF", *map(significant, us.values()), *(f"{x:.2f}" for x in ratios)])
    headers = [
        *("structure, 10 sensors", "value: us", "with gradient: us", "one by one: us"),
        *("gradient over value", "one by one over population", "over that of the chain"),
    ]
    print(f"\n## Gradients of a population: TN, {PARTICLES} particles, per particle, {SAMPLES} samples\n")
    print(table(headers, rows), flush=True)


def run(quick=False):
    """Print the tables."""
    rows = []
    for size in SIZES[:2] if quick else SIZES:
        seconds = best_of_rounds(calls(problem(*size)), rounds=2 if quick else 7)
        us = {name: 1e6 * s for name, s in seconds.items()}
        jax_value, jax_both = us.get("JAX value", np.nan), us.get("JAX value and gradient", np.nan)
        n = size[0] + 1
        rows.append(
            [
                "{} of {}, {} sensors".format(*size),
                *(significant(us[name]) for name in ("value", "value and gradient")),
                f"{us['value and gradient'] / us['value']:.2f}",
                f"{2 * n + 1}",
                *(significant(x) for x in (jax_value, jax_both, jax_both / jax_value)),
            ]
        )
    headers = [
        *("unknown springs", "value: us", "with gradient: us", "ratio", "ratio of central differences"),
        *("JAX value: us", "with gradient: us", "ratio"),
    ]
    print(f"\n## Gradient of a log-posterior: TN, {SAMPLES} samples, springs and sigma unknown\n")
    print(table(headers, rows), flush=True)
    run_populations(quick)
