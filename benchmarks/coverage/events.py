"""Wrong models: what the intervals of single events, and of several together, contain.

The chain is fitted to records, with errors, of a structure that it cannot be: its springs yield, or
its damping is another. The value sought is the one that fits all the events best, by the sum of their
maximised log-likelihoods.
"""

import time

import numpy as np
import xarray as xr
from scipy.optimize import minimize

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.chain import N_STOREYS, RATES, matrices, record_of
from benchmarks.coverage.errors import LEVEL
from benchmarks.coverage.simulated import Target, norm_and_cal, start_of
from benchmarks.tables import table
from pymc_features.study import paper

EVENTS, QUICK_EVENTS = 200, 12
TOGETHER = 3  # events in one check
SHUFFLES = 3  # of all events into groups
DURATION, RATE = 20.0, RATES[0]  # s, Hz
YIELD_DISPLACEMENT, POST_YIELD_RATIO = 0.007, 0.1  # m; drifts reach about twice as much
WRONG_DAMPING = 1.5  # times that of the fitted chain


def right(moved):
    """Floor accelerations (sensor, time) of the fitted chain itself."""
    return truth.response(matrices(), moved)["absolute_acceleration"]


def yielding(moved):
    """Of the chain with springs that yield."""
    springs = truth.Springs(np.full(N_STOREYS, paper.STIFFNESS), YIELD_DISPLACEMENT, POST_YIELD_RATIO)
    mass, damping = np.full(N_STOREYS, paper.MASS), matrices().damping
    return truth.spring_response(mass, damping, springs, moved, rtol=1e-7)["absolute_acceleration"]


def damped(moved):
    """Of the chain with more damping."""
    return truth.response(matrices(WRONG_DAMPING), moved)["absolute_acceleration"]


TRUTHS = {"right model": right, "springs yield": yielding, "damping 1.5 times as large": damped}


def run_events(quick=False):
    """Print coverage of one event and of three together."""
    n = QUICK_EVENTS if quick else EVENTS
    print(f"\n{n} simulated motions, 90 % intervals: share that contain the best value, and their width.\n")
    rows = []
    for name, respond in TRUTHS.items():
        started = time.perf_counter()
        events = [event_of(respond, seed) for seed in range(n)]
        best = common_value(events)
        single = {kind: [e[kind] for e in events] for kind in ("NORM", "CAL")}
        cells = [cell([x.ends for x in v], best) for v in single.values()]
        joint, growth, agree = together(events, np.random.default_rng(9))
        rows.append([name, *cells, cell(joint, best), f"{np.median(growth):.2g}", f"{100 * agree:.0f}"])
        print(f"{name}: best {best.round(4)}, {time.perf_counter() - started:.0f} s", flush=True)
    headers = ["truth", "NORM, one event", "CAL, one event", "event_check of three", "growth", "agree"]
    print("\n" + table(headers, rows), flush=True)


def event_of(respond, seed):
    """Data of one motion, the intervals of NORM and CAL, and draws of CAL."""
    moved = truth.motion(RATE, DURATION, seed)
    record, response, dt = record_of(moved), respond(moved), 1.0 / RATE
    rng = np.random.default_rng([5, seed])
    data = response + LEVEL * np.sqrt(np.mean(response**2)) * rng.standard_normal(response.shape)
    found, theta = norm_and_cal(record, data, dt, start_of(record, data, dt), rng)
    return {"target": Target(record, data, dt), "theta": theta, **found}


def common_value(events):
    """The factors (3,) with the largest sum of maximised log-likelihoods: the least sum of ln S."""

    def total(theta):
        return np.mean([np.log(event["target"].misfit(theta)) for event in events])

    start = np.mean([event["theta"] for event in events], axis=0)
    return minimize(total, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7}).x


def together(events, rng):
    """Intervals of `event_check` for groups of events, by how much each had to grow, and how many agree."""
    ends, growth, agree = [], [], []
    for _ in range(SHUFFLES):
        for group in rng.permutation(len(events))[: len(events) // TOGETHER * TOGETHER].reshape(-1, TOGETHER):
            found = pmf.event_check([posterior(events[i]["CAL"].draws) for i in group])
            ends.append(np.stack([found["lower"].values, found["upper"].values]))
            growth.append(found.attrs["growth"])
            agree.append(found.attrs["compatible"])
    return ends, growth, np.mean(agree)


def posterior(draws):
    """A DataTree with draws (n, 3) of theta."""
    return xr.DataTree.from_dict({"posterior": xr.Dataset({"theta": (("chain", "draw", "i"), draws[None])})})


def cell(ends, best):
    """Share of intervals (2, 3) that contain the best value, and their median width in %."""
    ends = np.array(ends)
    inside = np.mean((ends[:, 0] < best) & (ends[:, 1] > best))
    return f"{100 * inside:.0f} ({100 * np.median(ends[:, 1] - ends[:, 0]):.2g})"
