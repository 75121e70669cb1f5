"""Responses to samples of band-limited motions, against a simulator that shares nothing with the package."""

import functools
from itertools import product

import numpy as np
import pytest

import pymc_features as pmf
from benchmarks import truth
from benchmarks.band_limited import (
    OUTPUTS,
    RATES,
    SHORTER,
    SINGLE,
    cases,
    error,
    errors,
    oscillator,
    yielding,
)

BOUNDS = {0.15: 5e-4, 0.3: 1e-3}  # highest natural frequency over the rate: error of any quantity
ENDS, BETWEEN = 2e-3, 5e-4  # of records that begin and end in motion: in the first and last second, elsewhere
LINEAR = tuple(cases(10.0))
AT_A_THIRD = product(LINEAR, [100.0], [0.3])
YIELDING = product(["HystereticChain", "DuffingChain"], [100.0], BOUNDS)
FINER = 5


@functools.cache
def of(name, rate, share, ends="quiet"):
    """A case, its motion, and the exact response at the samples and `FINER` times as often."""
    highest = share * rate
    chosen = cases(highest)
    if name not in chosen:
        chosen = yielding(highest, truth.motion(rate, SHORTER, 1, ends=ends))
    case = chosen[name]
    moved = case.motion(rate, ends)
    fine = case.exact(moved, FINER)
    return case, moved, {quantity: values[:, ::FINER] for quantity, values in fine.items()}, fine


def check(found, bound):
    """All errors by quantity lie below a bound."""
    assert {quantity: e for quantity, e in found.items() if not e < bound} == {}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rate", "share"), [*product(LINEAR, RATES, [0.15]), *AT_A_THIRD, *YIELDING])
def test_structures(name, rate, share):
    """Every quantity, of records that are quiet at both ends; straight lines miss the bounds ten times."""
    case, moved, expected, _ = of(name, rate, share)
    check(errors(case, moved, expected, {}), BOUNDS[share])
    accelerations = {"absolute_acceleration": expected["absolute_acceleration"]}
    [found] = errors(case, moved, accelerations, {"interpolation": "linear"}).values()
    assert found > 10.0 * BOUNDS[share]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("share", SINGLE)
def test_single_modes(share, rate):
    """Absolute acceleration of one mode, which may be many times as fast as the samples."""
    case = oscillator(share * rate)
    moved = case.motion(rate)
    expected = {"absolute_acceleration": case.exact(moved)["absolute_acceleration"]}
    check(errors(case, moved, expected, {}), SINGLE[share])


def test_straight_lines_miss_a_mode_below_the_rate():
    """Control: at 0.8 of the rate."""
    case = oscillator(80.0)
    moved = case.motion(100.0)
    expected = {"absolute_acceleration": case.exact(moved)["absolute_acceleration"]}
    [found] = errors(case, moved, expected, {"interpolation": "linear"}).values()
    assert found > 10.0 * SINGLE[0.8]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rate"), [*product(LINEAR, [100.0]), ("HystereticChain", 100.0)], ids=str)
def test_records_that_begin_and_end_in_motion(name, rate):
    """The structure is at rest at the first sample, under a base that already moves."""
    case, moved, expected, _ = of(name, rate, 0.15, "moving")
    load, second = case.load(moved), int(rate)
    ends, between = {}, {}
    for quantity, values in expected.items():
        e = np.abs(case.simulated(load, quantity) - values) / np.abs(values).max()
        ends[quantity] = max(e[:, : second + 1].max(), e[:, -second - 1 :].max())
        between[quantity] = e[:, second + 1 : -second - 1].max()
    check(ends, ENDS)
    check(between, BETWEEN)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain", "coupled damping", "two supports", "forces", "HystereticChain"])
def test_outputs_between_the_samples_and_fewer(name):
    """Finer outputs are true as well; common instants agree, to the solver's error in what yields."""
    case, moved, _, fine = of(name, 100.0, 0.15)
    load = case.load(moved)
    same = 1e-12 if case.springs is None else 1e-6
    for quantity, values in fine.items():
        found = case.simulated(load, quantity, dt=load.dt / FINER)
        at_samples = case.simulated(load, quantity)
        assert error(found, values) < 5e-4, quantity
        assert error(found[:, ::FINER], at_samples) < same, quantity
        assert error(case.simulated(load, quantity, dt=2.0 * load.dt), at_samples[:, ::2]) < same, quantity


@pytest.mark.parametrize("name", ["chain", "coupled damping", "two supports", "forces", "two modes"])
def test_sensors_are_rows_of_all(name):
    """Whatever share of the motion a quantity takes directly, a selection takes the same."""
    case, moved, expected, _ = of(name, 50.0, 0.15, "moving")
    load = case.load(moved)
    for quantity in ("absolute_acceleration", "relative_acceleration"):
        settings = {"quantity": quantity, "n_modes": case.n_modes}
        found = pmf.simulate(case.structure, load, sensors=[2, 0], **settings).values
        rows = pmf.simulate(case.structure, load, outputs=OUTPUTS, **settings).values
        whole = case.simulated(load, quantity)
        assert error(found, whole[[2, 0]]) < 1e-12
        assert error(rows, OUTPUTS @ whole) < 1e-12
        assert error(found, expected[quantity][[2, 0]]) < ENDS
