"""No argument, however odd, ends in a message of NumPy, PyTensor or Python, or in a silent wrong result.

A function of each kind of check is called with each argument replaced in turn by each of eight odd
values. Each is taken, where the table says so, or refused by a sentence of this package that names the
argument.
"""

import numpy as np
import pytest

import pymc_features as pmf
from support.border import Call, fate, wrong
from support.calls import CALLS

CASES = [(name, argument) for name, call in CALLS.items() for argument in call.arguments]


@pytest.mark.slow
@pytest.mark.parametrize("name, argument", CASES, ids=["-".join(case) for case in CASES])
def test_odd_argument(name, argument):
    assert wrong(CALLS[name], argument) == {}


def test_calls_work():
    """With the values of the table itself: what is refused is refused for the odd one."""
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
