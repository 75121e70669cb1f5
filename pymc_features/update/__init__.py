"""From measured channels and a configuration file to an updated model and its report.

    problem = read_problem("update.toml")
    result = run_update(problem, out="update-output")
    write_outputs(problem, result, "update-output")

The command `pymc-features update` does the same.
"""

from pymc_features.lazy import lazily

TYPE_CHECKING = False  # that of `typing`
if TYPE_CHECKING:
    from pymc_features.update.examples import write_example  # noqa: F401
    from pymc_features.update.problem import Problem, read_config, read_problem  # noqa: F401
    from pymc_features.update.report.outputs import write_outputs  # noqa: F401
    from pymc_features.update.run import run_update  # noqa: F401

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
