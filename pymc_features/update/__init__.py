"""From measured channels and a configuration file to an updated model and its report.

    problem = read_problem("update.toml")
    result = run_update(problem, out="update-output")
    write_outputs(problem, result, "update-output")

The command `pymc-features update` does the same.
"""

from pymc_features.lazy import lazily

# keys are checked, and reports are made, without PyMC
PLACES = {
    "Problem": "problem",
    "read_config": "problem",
    "read_problem": "problem",
    "run_update": "run",
    "write_example": "examples",
    "write_outputs": "report.outputs",
}
__all__ = [*PLACES]
__getattr__, __dir__ = lazily(__name__, PLACES)
