"""Bayesian updating of structural models from measured vibration, as a plugin for PyMC.

The flow: read a record, declare a structure whose parameters are random variables, compare its response
with the measured one by a feature likelihood, sample.

    record = pmf.read_record("elcentro.dat", units="g")
    with pm.Model(coords={"sensor": range(10)}):
        theta = pm.Uniform("theta", 0.5, 1.5)
        sigma = pm.Uniform("sigma", 0.0, 2.0)
        acceleration = pmf.response(pmf.paper.chain(theta), record)
        pmf.TruncNormalFeature("y", mu=acceleration, sigma=sigma, observed=measured)
        idata = pmf.sample()

A feature likelihood is a probability model of the mean-square discrepancy of each sensor, not of each time
sample: its uncertainty does not depend on the sampling rate.
"""

from importlib import import_module
from importlib.util import find_spec
from warnings import warn

TYPE_CHECKING = False  # that of `typing` for type checkers, which takes longer to import than this file
if TYPE_CHECKING:
    from pymc_features.public import *  # noqa: F403


#: Names that need no PyMC, and where they are.
LIGHT = {
    **dict.fromkeys(("Record", "Loading"), "records"),
    **dict.fromkeys(("read_channels", "read_matrices", "read_record"), "io"),
    "read_modal": "modal.files",
}


def __getattr__(name: str):
    """A module, or a public name, of which the first that needs PyMC imports all of them.

    So a file is read in less than a second, and the command can answer to Ctrl-C before seconds of imports
    begin.
    """
    if name in LIGHT:
        module = import_module(f"{__name__}.{LIGHT[name]}")
        return globals().setdefault(name, getattr(module, name))
    if name == "__version__":
        from importlib.metadata import version

        return globals().setdefault(name, version("pymc-features"))
    if name != "__all__":
        if name.startswith("__"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if find_spec(f"{__name__}.{name}"):
            return import_module(f"{__name__}.{name}")
    public = import_module(f"{__name__}.public")
    if name == "__all__":
        return globals().setdefault(name, public._all)
    if name in public._all:
        return globals().setdefault(name, getattr(public, name))
    return _of_a_submodule(public, name)


def _of_a_submodule(public, name: str):
    """A name of a submodule, with a warning that says where it is: many stood here before."""
    short = {"plot_response_bands": "response"}.get(name, name.removeprefix("plot_"))
    for place in ("plots",) if short != name else public._all:
        module = getattr(public, place)
        if short in getattr(module, "__all__", ()):
            message = f"`pymc_features.{name}` is `pymc_features.{place}.{short}`, and will be only there."
            warn(message, FutureWarning, stacklevel=3)
            return getattr(module, short)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *__getattr__("__all__")})
