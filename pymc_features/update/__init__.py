"""From measured channels and a configuration file to an updated model and its report.

    problem = read_problem("update.toml")
    result = run_update(problem, out="update-output")
    write_outputs(problem, result, "update-output")

The command `pymc-features update` does the same.
"""

from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pymc_features.update.configuration import read_config as read_config
    from pymc_features.update.examples import write_example as write_example
    from pymc_features.update.problem import Problem as Problem
    from pymc_features.update.problem import read_problem as read_problem
    from pymc_features.update.report.outputs import write_outputs as write_outputs
    from pymc_features.update.run import run_update as run_update

PLACES = {
    "Problem": "problem",
    "read_config": "configuration",
    "read_problem": "problem",
    "run_update": "run",
    "write_example": "examples",
    "write_outputs": "report.outputs",
}
__all__ = list(PLACES)


def __getattr__(name: str):
    """A public name, imported when it is used: keys are checked, and reports are made, without PyMC."""
    if name not in PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, getattr(import_module(f"{__name__}.{PLACES[name]}"), name))
