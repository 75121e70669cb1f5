"""The kernels of all families, called with their inputs one by one instead of in named tuples."""

import numpy as np

from pymc_features.simulators import FAMILIES
from pymc_features.simulators.oscillators.arguments import NO_DIRECT

DAMPINGS = {  # alpha and beta, ratios of n modes
    "none": lambda n: ((0.0, 0.0), np.zeros(n)),
    "rayleigh": lambda n: ((0.2, 1e-3), np.zeros(n)),
    "heavy": lambda n: ((20.0, 0.05), np.zeros(n)),
    "light": lambda n: ((0.0, 0.0), np.full(n, 1e-6)),
    "equal": lambda n: ((0.1, 5e-4), np.full(n, 0.03)),
    "critical": lambda n: ((0.0, 0.0), np.full(n, 1.0)),
    "unequal": lambda n: ((0.1, 0.0), np.linspace(0.01, 0.3, n)),
    "overdamped": lambda n: ((0.0, 0.0), np.linspace(4.0, 1.5, n)),
}


def flat(family: str, name: str):
    """A kernel that takes the family's inputs, the code of the quantity, and what follows, in their order.

    The inputs are straight lines between their samples: `direct` is not among them.

    Arrays are made such as the package passes, else the kernels would be compiled for others as well.
    """
    spec = FAMILIES[family]
    at, n, of_discrepancy = (
        list(spec.inputs).index("direct"),
        len(spec.inputs),
        name in ("discrepancy_gradient", "population_gradient"),
    )
    is_lone_gradient = name == "discrepancy_gradient"
    run = spec.of_squares("misfit_gradient") if is_lone_gradient else spec.kernels[name]

    def kernel(*given):
        if np.ndim(given[at]) != np.ndim(NO_DIRECT):
            given = [*given[:at], NO_DIRECT, *given[at:]]
        given = [np.require(x, requirements=["C", "W"]) if isinstance(x, np.ndarray) else x for x in given]
        more = given[n + 1 :]
        if of_discrepancy:  # weights (s,) or (p, s) of e_j alone
            more = (*more[:-1], np.asarray(more[-1])[..., None])
        if name.endswith("tangent"):
            first = len(more) - len(spec.parameters)
            more = (*more[:first], tuple(more[first:]))
        return run(*spec.assemble(given[:n], given[n]), *more)

    return kernel


def flat_kernels(family: str) -> dict:
    """All kernels of a family by name."""
    return {name: flat(family, name) for name in (*FAMILIES[family].kernels, "discrepancy_gradient")}


CHAIN = flat_kernels("chain")
chain_response, chain_discrepancy, chain_misfit = (CHAIN[k] for k in ("response", "discrepancy", "misfit"))
response_gradient, response_tangent = CHAIN["response_gradient"], CHAIN["response_tangent"]
discrepancy_gradient, discrepancy_tangent = CHAIN["discrepancy_gradient"], CHAIN["discrepancy_tangent"]
population_discrepancy, population_misfit = CHAIN["population_discrepancy"], CHAIN["population_misfit"]
population_gradient = CHAIN["population_gradient"]

LINEAR = flat_kernels("linear")
linear_response, linear_discrepancy, linear_misfit = (
    LINEAR[name] for name in ("response", "discrepancy", "misfit")
)
linear_response_gradient, linear_response_tangent = LINEAR["response_gradient"], LINEAR["response_tangent"]
linear_discrepancy_gradient = LINEAR["discrepancy_gradient"]
linear_misfit_gradient = LINEAR["misfit_gradient"]
linear_discrepancy_tangent = LINEAR["discrepancy_tangent"]
linear_population_discrepancy = LINEAR["population_discrepancy"]
linear_population_misfit = LINEAR["population_misfit"]
linear_population_gradient = LINEAR["population_gradient"]
