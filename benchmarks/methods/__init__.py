"""Methods compared: one method, one file. `METHODS` maps a name to `function(problem, seed) -> Result`.

Files of optional packages import them inside the function: an ImportError is reported in the table.
"""

from benchmarks.methods import (
    abc_elfi,
    abc_pyabc,
    abc_pymc,
    abc_rejection,
    abc_sbi,
    abc_subset,
    abc_subset_textbook,
    black_box,
    nested_dynesty,
    nested_ultranest,
    nuts_numpyro,
    pymc_smc,
    smc_blackjax,
    smc_smcpy,
    subset_parallel_abus,
)
from benchmarks.methods.result import Accepted, NotThereError, Result

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

# likelihood-free: `function(problem, seed) -> Accepted` for a `ToleranceProblem`
ABC_METHODS = {
    "SubsetSimulation (ours)": abc_subset.method,
    "rejection, our batched simulator": abc_rejection.method,
    "subset simulation, textbook": abc_subset_textbook.method,
    "PyMC Simulator, gaussian, rho": abc_pymc.of_rho("gaussian"),
    "PyMC Simulator, laplace, rho": abc_pymc.of_rho("laplace"),
    "PyMC Simulator, gaussian, histories": abc_pymc.of_histories,
    "pyABC": abc_pyabc.method,
    "ELFI SMC": abc_elfi.method,
    "sbi SMCABC": abc_sbi.method,
}

__all__ = ["ABC_METHODS", "METHODS", "Accepted", "NotThereError", "Result"]
