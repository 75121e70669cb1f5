"""Methods compared: one method, one file. `METHODS` maps a name to `function(problem, seed) -> Result`.

Files of optional packages import them inside the function: an ImportError is reported in the table.
"""

from benchmarks.methods import (
    black_box,
    nested_dynesty,
    nested_ultranest,
    nuts_numpyro,
    pymc_smc,
    smc_blackjax,
    smc_smcpy,
    subset_parallel_abus,
)
from benchmarks.methods.result import NotThereError, Result

METHODS = {
    "PopulationIMH (ours)": pymc_smc.ours("PopulationIMH"),
    "PopulationMH (ours)": pymc_smc.ours("PopulationMH"),
    "TMCMC (ours)": pymc_smc.ours("TMCMC"),
    "PersistentSMC (ours)": pymc_smc.ours("PersistentSMC"),
    "PyMC IMH, our Op": pymc_smc.stock("IMH"),
    "PyMC MH, our Op": pymc_smc.stock("MH"),
    "PyMC IMH, SciPy black box": black_box.method,
    "UltraNest": nested_ultranest.method,
    "dynesty": nested_dynesty.method,
    "SMCPy": smc_smcpy.method,
    "parallel-abus": subset_parallel_abus.method,
    "BlackJAX tempered SMC, JAX model": smc_blackjax.method,
    "NumPyro NUTS, JAX model": nuts_numpyro.method,
}

__all__ = ["METHODS", "NotThereError", "Result"]
