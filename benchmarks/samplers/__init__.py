"""Samplers of any PyMC model: one sampler, one file. `SAMPLERS`: name to `function(problem, seed) -> Run`.

Another one is one line: `SAMPLERS["mine"] = of_idata(lambda model, seed: ...)`, with a function that returns
a DataTree.
"""

from benchmarks.samplers import automatic, nuts, smc, smc_nuts
from benchmarks.samplers.run import Run, of_idata

SAMPLERS = {
    "pmf.sample": of_idata(automatic.sample),
    "PersistentSMC": of_idata(smc.sample),
    "pmf.sample_nuts": of_idata(smc_nuts.sample),
    "PyMC NUTS": of_idata(nuts.by("pymc")),
    "nutpie": of_idata(nuts.by("nutpie")),
    "NumPyro NUTS": of_idata(nuts.by("numpyro")),
}

__all__ = ["SAMPLERS", "Run", "of_idata"]
