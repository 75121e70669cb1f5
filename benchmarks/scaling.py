"""How the cost of an evaluation grows with samples, sensors, degrees of freedom and particles.

One table for each, with exponents fitted by least squares in log-log over all rows: 1 is proportional
to the size, less than 1 says that a fixed cost still counts. Long records have a table of their own: their
mean squares and gradients come from tables, beside the march that these replace.
"""

import time

import numpy as np

import pymc_features as pmf
from benchmarks.case import build, record_of_length
from benchmarks.routes import batched, long_records, scalar
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds, fitted_exponent

KERNELS = {
    "batched": batched.prepare,
    "with increments": batched.prepare_with_increments,
    "one at a time": scalar.prepare,
}


def samples(size):
    """N_D, with ten storeys and sensors and 50 particles."""
    return build(record_of_length(size), particles=50)


def sensors(size):
    """N_0, with ten storeys, 2000 samples, 100 particles."""
    return build(record_of_length(2000), particles=100, n_sensors=size)


def degrees_of_freedom(size):
    """DOF, with five sensors, all modes, 1000 samples, 48 particles."""
    return build(record_of_length(1000), particles=48, n_dof=size, n_sensors=5)


def particles(size):
    """Particles, with ten storeys and sensors and 1559 samples."""
    return build(record_of_length(1559), particles=size)


STUDIES = {
    "samples N_D": (samples, (1_000, 3_000, 10_000, 30_000, 100_000)),
    "sensors N_0": (sensors, (1, 2, 3, 5, 7, 10)),
    "degrees of freedom": (degrees_of_freedom, (5, 10, 20, 40, 70, 100)),
    "particles": (particles, (50, 100, 250, 500, 1000, 2000, 4000)),
}


def measure(make_case, sizes, rounds):
    """Seconds of a population evaluation and its particle-steps: {kernel: [s]}, [steps]."""
    seconds, steps = {name: [] for name in KERNELS}, []
    for size in sizes:
        case = make_case(size)
        found = best_of_rounds({name: make(case) for name, make in KERNELS.items()}, rounds)
        steps.append(case.steps)
        for name in KERNELS:
            seconds[name].append(found[name])
    return seconds, steps


LONG = (2_001, 4_001, 20_001, 60_001, 200_001)  # samples at 200 Hz


def relative_difference(found, expected):
    """Largest difference beside the largest number."""
    return np.abs(found - expected).max() / np.abs(expected).max()


def run_long_records(rounds):
    """Print the cost of e_j and of its gradient from tables against samples, ten storeys and five sensors."""
    rows, costs = [], {"table": [], "gradient": []}
    for size in LONG:
        record = pmf.Record(np.random.default_rng(0).standard_normal(size), 0.005)
        case = build(record, particles=512, n_dof=10, n_sensors=5)
        few = case.first(64)
        calls = {
            "table": long_records.prepare(case),
            "gradient": long_records.prepare_gradient(case),
            "march": batched.prepare(few),
            "marching gradient": long_records.prepare_marching_gradient(few),
        }
        start = time.process_time()
        difference = np.abs(calls["table"]()[:64] / calls["march"]() - 1.0).max()
        first = time.process_time() - start
        slope = relative_difference(calls["gradient"]()[:64], calls["marching gradient"]())
        best = best_of_rounds(calls, rounds)
        us = {name: 1e6 * s / (512 if name in costs else 64) for name, s in best.items()}
        for name, own in costs.items():
            own.append(us[name])
        both = (us["table"] + us["gradient"]) / us["table"]
        cells = (first, us["march"], us["table"], us["march"] / us["table"], us["marching gradient"])
        cells += us["gradient"], us["marching gradient"] / us["gradient"], both
        rows.append([f"{size:,}", *map(significant, cells), f"{difference:.0e}", f"{slope:.0e}"])
    exponents = {name: f"{fitted_exponent(LONG, own):.2f}" for name, own in costs.items()}
    rows.append(["exponent", "", "", exponents["table"], "", "", exponents["gradient"], "", "", "", ""])
    print("\n## Long records: us per particle, modes included (ten storeys, five sensors, 200 Hz)\n")
    headers = [
        *("samples N_D", "first call: s", "march", "table", "ratio", "gradient by the march"),
        *("gradient from tables", "ratio", "value and gradient over value"),
        *("relative difference of e_j", "of the gradient"),
    ]
    print(table(headers, rows), flush=True)


def run(quick=False):
    """Print one table for each study."""
    run_long_records(rounds=2 if quick else 7)
    for name, (make_case, sizes) in STUDIES.items():
        seconds, steps = measure(make_case, sizes, rounds=2 if quick else 7)
        print(f"\n## Cost against {name} ({make_case.__doc__.split(', ', 1)[1].rstrip('.')})\n")
        headers = [name]
        for kernel in KERNELS:
            headers += [f"{kernel}: ms", "ns per particle and step"]
        rows = []
        for i, size in enumerate(sizes):
            cells = [[1e3 * seconds[k][i], 1e9 * seconds[k][i] / steps[i]] for k in KERNELS]
            rows.append([f"{size:,}", *[significant(value) for pair in cells for value in pair]])
        exponents = [[f"{fitted_exponent(sizes, seconds[k]):.2f}", ""] for k in KERNELS]
        rows.append(["exponent", *[cell for pair in exponents for cell in pair]])
        print(table(headers, rows), flush=True)
