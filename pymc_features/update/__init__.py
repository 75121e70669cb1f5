"""From measured channels and a configuration file to an updated model and its report.

    problem = read_problem("update.toml")
    result = run_update(problem, out="update-output")
    write_outputs(problem, result, "update-output")

The command `pymc-features update` does the same.
"""

from importlib import import_module

PLACES = {
    "Problem": "problem",
    "read_config": "document",
    "read_problem": "problem",
    "run_update": "run",
    "write_example": "examples.write",
    "write_outputs": "report.outputs",
}
__all__ = list(PLACES)


def __getattr__(name: str):
    """A public name, imported when it is asked for: the keys of a file are checked without PyMC."""
    if name not in PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{PLACES[name]}"), name)
