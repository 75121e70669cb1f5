"""No argument, however odd, ends in a message of NumPy, PyTensor or Python, or in a silent wrong result.

Everything public is called with each argument replaced in turn by each of a dozen odd values. It is either
taken, where the tables say so, or refused by a sentence of this package that names the argument.
"""

import inspect
from types import ModuleType

import numpy as np
import pytest

import pymc_features as pmf
from support.border import Call, fate, wrong
from support.calls import events, files, likelihoods, modal, results, samplers, structures

TABLES = (structures, likelihoods, files, modal, samplers, results, events)
CALLS = {name: call for table in TABLES for name, call in table.CALLS.items()}
CASES = [(name, argument) for name, call in CALLS.items() for argument in call.arguments]


@pytest.mark.slow
@pytest.mark.parametrize("name, argument", CASES, ids=["-".join(case) for case in CASES])
def test_odd_argument(name, argument):
    assert wrong(CALLS[name], argument) == {}


def test_calls_work():
    """With the values of the tables themselves: what is refused is refused for the odd one."""
    for name, call in CALLS.items():
        argument = next(iter(call.arguments))
        assert fate(call, argument, call.arguments[argument]) == "taken", name


def public():
    """Functions and classes, and those of public modules, by name."""
    for name in pmf.__all__:
        value = getattr(pmf, name)
        if isinstance(value, ModuleType):
            members = [n for n in getattr(value, "__all__", []) if inspect.isfunction(getattr(value, n))]
            yield from ((f"{name}.{member}", getattr(value, member)) for member in members)
        else:
            yield name, value


def test_every_argument_is_tried():
    missing = []
    for name, value in public():
        tried = CALLS[name].arguments if name in CALLS else ()
        kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        parameters = inspect.signature(value).parameters.values()
        missing += [f"{name}: {p.name}" for p in parameters if p.kind not in kinds and p.name not in tried]
    assert [entry for entry in missing if not entry.endswith(": axes")] == []  # once for all of them


@pytest.mark.parametrize(
    "function, told",
    [
        (lambda x: np.zeros(2) if x else None, "ValueError in test_odd_arguments.py"),
        (lambda x: x, "taken"),
        (lambda x: pmf.sigma_mpv([x[0] - 2.0]), "refused without `x`"),
        (lambda x: pmf.Record([0.0, 1.0], dt=1.0).first(x), "refused without `x`"),
    ],
    ids=["inside", "taken", "another", "unnamed"],
)
def test_what_is_not_refused_is_told(function, told):
    """The negative control."""
    assert fate(Call(function, {"x": None}), "x", np.ones(2)).startswith(told)
