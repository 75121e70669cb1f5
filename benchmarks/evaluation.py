"""Cost of one fused evaluation theta -> e_j, for each particle and output step, against other routes.

Ten storeys, ten sensors, a population of 500 under the El Centro record, at its own step and at a tenth
of it. Every route is checked against the scalar kernel before it is timed. A route is also compared with
the machine's matrix product and with the most that its processor does, fused products from registers: 300
floating-point operations a step (ten modes of ten for the recursion, 200 for the output) at that rate would
be 100 %.
"""

import numpy as np

import pymc_features as pmf
from benchmarks import likelihood
from benchmarks.case import build
from benchmarks.routes import ROUTES, scalar
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds, fused_products, matrix_product

FLOPS_PER_STEP = 300.0
TOLERANCE = 1e-9  # of the largest e_j
PARTICLES = 500
FIRST = "our batched kernel"


def ground_motion():
    """El Centro 1940, or a synthetic record of the same length where it cannot be had."""
    try:
        return pmf.datasets.el_centro()
    except pmf.exceptions.DatasetUnavailableError as error:
        print(f"El Centro record not available, a synthetic one takes its place. {error}".splitlines()[0])
        return pmf.synthetic_earthquake(31.16, 0.02, random_seed=1940, pga=3.13)


def check(name, found, reference):
    """Stop if a route does not give the reference's numbers; return its largest error."""
    error = np.abs(found - reference[: len(found)]).max() / reference.max()
    if not error <= TOLERANCE:
        raise RuntimeError(
            f"{name}: e_j differ from the scalar kernel's by {error:.1e} of the largest, more than "
            f"{TOLERANCE:g}. Nothing is timed until the routes agree."
        )
    return error


def prepared_routes(case):
    """Checked calls of every route that can run here, their errors, and why the others cannot."""
    reference = scalar.prepare(case)()
    calls, errors, missing = {}, {}, {}
    for name, route in ROUTES.items():
        part = case.first(route.particles)
        try:
            calls[name] = route.prepare(part)
        except ImportError as error:
            missing[name] = f"not installed ({error})"
            continue
        errors[name] = check(name, calls[name](), reference)
    return calls, errors, missing


def measure(case, rounds):
    """Rows of the table for one case, and the rates of the matrix product and of fused products [flop/s]."""
    calls, errors, missing = prepared_routes(case)
    yardsticks = {"dgemm": matrix_product(), "peak": fused_products()}
    seconds = best_of_rounds({**calls, **{name: call for name, (call, _) in yardsticks.items()}}, rounds)
    rates = [flops / seconds.pop(name) for name, (_, flops) in yardsticks.items()]
    steps = {name: case.first(ROUTES[name].particles).steps for name in calls}
    cost = {name: seconds[name] / steps[name] for name in calls}
    rows = []
    for name in ROUTES:
        if name in missing:
            rows.append([name, missing[name], "-", "-", "-", "-", "-"])
            continue
        ns, shares = 1e9 * cost[name], [100.0 * FLOPS_PER_STEP / cost[name] / rate for rate in rates]
        micro = 1e6 * cost[name] * case.observed.shape[1]
        ratio = cost[name] / cost[FIRST]
        rows.append([name, *map(significant, (ns, micro, ratio, *shares)), f"{errors[name]:.0e}"])
    return rows, rates


def run(quick=False):
    """Print one table for each sampling step."""
    record = ground_motion()
    for substeps in (1, 10):
        case = build(record, particles=PARTICLES, substeps=substeps)
        n_times = case.observed.shape[1]
        print(f"\n## One evaluation theta -> e_j: 10 DOF, 10 sensors, N_D = {n_times}, batch of 500\n")
        rows, (dgemm, peak) = measure(case, rounds=3 if quick else 9)
        costs = ["ns per particle and step", "us per particle", "x batched", "% of dgemm", "% of peak"]
        print(table(["route", *costs, "error"], rows))
        print(
            f"\ndgemm of 1000 x 1000: {dgemm / 1e9:.1f} Gflop/s, {100.0 * dgemm / peak:.0f} % of the peak of "
            f"{peak / 1e9:.1f} Gflop/s, one thread. Least of interleaved rounds."
        )
    likelihood.run(quick)
