"""What an exact gradient costs: value and gradient together over the value alone.

Through PyMC (log-posterior of TN, springs unknown), where a sampler uses it, and of the kernels themselves;
beside central differences, which grow with the number of parameters, and JAX.
"""

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.case import ALPHA, BETA, record_of_length
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds

# number of unknown springs -> degrees of freedom; ten sensors each, and one for each storey of the largest
SIZES = ((1, 10, 10), (10, 10, 10), (100, 100, 10), (100, 100, 100))
SAMPLES = 1559


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


def run(quick=False):
    """Print the table."""
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
