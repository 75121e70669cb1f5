"""No argument, however odd, ends in a message of NumPy, PyTensor or Python, or in a silent wrong result.

A function of each kind of check is called with each argument replaced in turn by each of a dozen odd
values. Each is taken, where the tables say so, or refused by a sentence of this package that names the
argument.
"""

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


@pytest.mark.parametrize(
    "function, told",
    [
        (lambda x: np.zeros(2) if x else None, "ValueError in test_odd_arguments.py"),
        (lambda x: x, "taken"),
        (lambda x: pmf.likelihoods.sigma_mpv([x[0] - 2.0]), "refused without `x`"),
        (lambda x: pmf.Record([0.0, 1.0], dt=1.0).first(x), "refused without `x`"),
    ],
    ids=["inside", "taken", "another", "unnamed"],
)
def test_what_is_not_refused_is_told(function, told):
    """The negative control."""
    assert fate(Call(function, {"x": None}), "x", np.ones(2)).startswith(told)
