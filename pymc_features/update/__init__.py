"""From measured channels and a configuration file to an updated model and its report.

    problem = read_problem("update.toml")
    result = run_update(problem, out="update-output")
    write_outputs(problem, result, "update-output")

The command `pymc-features update` does the same.
"""

from pymc_features.update.config.document import read_config
from pymc_features.update.examples.write import write_example
from pymc_features.update.problem import Problem, read_problem
from pymc_features.update.report.outputs import write_outputs
from pymc_features.update.run import run_update

__all__ = [
    "Problem",
    "read_config",
    "read_problem",
    "run_update",
    "write_example",
    "write_outputs",
]
