"""Samplers of any PyMC model: one sampler, one file. `SAMPLERS`: name to `function(problem, seed) -> Run`.

Another one is one line: `SAMPLERS["mine"] = of_idata(lambda model, seed: ...)`, with a function that returns
a DataTree.
"""

from benchmarks.samplers import automatic, blackjax_smc, nested, nuts, smc, smc_nuts
from benchmarks.samplers.run import Run, of_idata

SAMPLERS = {
    "pmf.sample": of_idata(automatic.sample),
    "PersistentSMC": of_idata(smc.sample),
    "pmf.sample_nuts": of_idata(smc_nuts.sample),
    "PyMC NUTS": of_idata(nuts.by("pymc")),
    "nutpie": of_idata(nuts.by("nutpie")),
    "NumPyro NUTS": of_idata(nuts.by("numpyro")),
    "BlackJAX SMC": of_idata(blackjax_smc.sample),
    "dynesty": of_idata(nested.dynesty),
    "UltraNest": of_idata(nested.ultranest),
}

__all__ = ["SAMPLERS", "Run", "of_idata"]
