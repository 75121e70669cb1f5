"""One table, problems by samplers, for posteriors of any number of parameters with known answers."""

import numpy as np

from benchmarks.accuracy import accuracy
from benchmarks.known import problem
from benchmarks.posteriors import collect
from benchmarks.samplers import SAMPLERS
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds
from pymc_features.smc.density.evaluation import population_logp

PARTICLES = 256

HEADERS = (
    *("problem", "sampler", "R", "s", "values", "gradients", "eff. draws (least)", "values per eff."),
    *("error 5/50/95 %", "in SE", "one run 5/50/95 %", "ln Z bias +- SE", "sd", "SE/sd", "mode weights"),
)

NOTES = """
A gradient counts as many values as one of a whole population costs, measured here. `eff. draws`: independent
draws with the same mean square error of the shares below the exact quantiles, mean of the parameters (and
least of them). `error`: mean over R runs, root mean square of the parameters, in per cent of the exact 5-95 %
width; `in SE`: the same over its standard error, about 1 where there is no bias (1.1 for R = 10, more for
fewer). `one run`: root mean square error of single runs. NUTS gives no evidence; what NumPyro evaluates in
its warm-up is not counted. Mode weights: mean +- standard deviation of the runs."""


def gradient_cost(model, rounds=3):
    """Seconds of the gradient of a population over those of its values, around the initial point."""
    point = model.initial_point()
    start = np.concatenate([np.ravel(point[v.name]) for v in model.value_vars]).astype(float)
    particles = start + 0.01 * np.random.default_rng(0).standard_normal((PARTICLES, start.size))
    logp = population_logp(model, point, {})
    logp.compile_gradient()
    calls = {"values": lambda: logp(particles), "gradients": lambda: logp.gradient(particles)}
    seconds = best_of_rounds(calls, rounds)
    return seconds["gradients"] / seconds["values"]


def percent(three):
    """Three errors in per cent of the width."""
    return " / ".join(f"{100.0 * value:.1f}" for value in three)


def root_mean_square(x):
    """Over the parameters (3, d)."""
    return np.sqrt((x**2).mean(axis=1))


def cells(a):
    """Cells of a row but the first, of an `Accuracy`."""
    evidence = ["-", "-", "-"]
    if np.isfinite(a.evidence_bias):
        evidence = [f"{a.evidence_bias:+.2f} +- {a.evidence_bias_se:.2f}", significant(a.evidence_sd, 2)]
        evidence.append(significant(a.evidence_se_ratio, 2))
    modes = "-"
    if a.mode_weights is not None:
        pairs = zip(a.mode_weights, a.mode_weights_sd, strict=True)
        modes = " ".join(f"{weight:.2f}+-{sd:.2f}" for weight, sd in pairs)
    return [
        str(a.runs),
        *map(significant, (a.seconds, a.values, a.gradients)),
        f"{significant(a.effective)} ({significant(a.effective_least)})",
        significant(a.cost_per_effective),
        percent(root_mean_square(a.error)),
        " / ".join(significant(z, 2) for z in root_mean_square(a.error_in_se)),
        percent(a.typical),
        *evidence,
        modes,
    ]


def rows_of(name, samplers, share):
    """Rows of one problem, and what to say about them."""
    there = problem(name)
    if not there.answer.labels:
        return [], [f"{name}: the answer is {there.answer.note}."]
    ratio = gradient_cost(there.model)
    results, seconds, reasons = collect(samplers, there, *share)
    rows = []
    for sampler in samplers:
        if sampler in results:
            judged = accuracy(results[sampler], seconds[sampler], there, ratio)
            rows.append([name, sampler, *cells(judged)])
        else:
            rows.append([name, sampler, reasons[sampler][0], *["-"] * (len(HEADERS) - 3)])
    z, error = there.answer.log_evidence, there.answer.log_evidence_se
    said = [
        f"{name}: exact ln Z {z:.3f} +- {error:.3f}; a gradient costs {ratio:.1f} values. {there.answer.note}"
    ]
    return rows, said + [f"{name}, {key}: {status} ({reason})" for key, (status, reason) in reasons.items()]


def compare_all(title, names, share, samplers=None):
    """Print the table, of what is done if interrupted; `share`: runs, seconds after the first, patience."""
    print(f"\n## {title}\n")
    rows, said = [], []
    try:
        for name in names:
            print(name, flush=True)
            more = rows_of(name, samplers or SAMPLERS, share)
            rows += more[0]
            said += more[1]
    finally:
        print("\n" + table(HEADERS, rows))
        print(NOTES)
        print("\n".join(said))
