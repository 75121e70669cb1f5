"""An answer from long chains, and from importance sampling with what they found: the better one is stated.

The evidence is of both together, by bridge sampling.
"""

import time

import numpy as np

from benchmarks.known.exact import bridge, estimates, importance
from benchmarks.known.exact.chains import long_run

CHAINS = 256
MOST_ITERATIONS = 2000
MOST_POINTS = {11: 4_000_000, 22: 3_000_000, 41: 600_000}
ENOUGH = 200_000  # effective points
BRIDGED = 200  # draws of each chain, at most, for the evidence
TRUSTED_EFFICIENCY, TRUSTED_SHAPE = 0.1, 0.5
SHORT = 1.1  # R-hat of chains too short for more than a rough answer
FORGETFUL = 0.3  # largest correlation of early and late means of chains that do not stay where they start


def until(seconds, most):
    """Whether less than `seconds` of the processor have passed and less than `most` is done."""
    start = time.process_time()
    return lambda done: done < 10 or (done < most and time.process_time() - start < seconds)


def answer(target, now, moves, rng, seconds):
    """Entry of `answers.json` from tempered particles."""
    start_gradients = target.gradients
    now = now.chosen(rng.permutation(len(now.value))[:CHAINS])
    draws = long_run(now, moves, until(seconds, MOST_ITERATIONS))
    gradients = target.gradients - start_gradients
    parameters = target.parameters(draws.reshape(-1, target.d)).reshape(draws.shape)
    quantiles, errors, effective = estimates.of_chains(parameters)
    memory, r_hat = estimates.memory(draws), estimates.r_hat(draws)

    mixture = importance.proposal_from(target, draws[: CHAINS // 2].reshape(-1, target.d), rng)
    most = next((n for d, n in MOST_POINTS.items() if target.d <= d), min(MOST_POINTS.values()))
    in_time = until(0.5 * seconds, most)
    weighted = importance.sample(target, mixture, rng, lambda n, ess: in_time(n) and ess < ENOUGH)
    of_points = estimates.of_weighted(target.parameters(weighted.z), weighted.weights)
    others = draws[
        CHAINS // 2 :, :: -(-draws.shape[1] // BRIDGED)
    ]  # not those that the proposal was fitted to
    ratio = importance.log_ratio(target, mixture, others.reshape(-1, target.d).astype(float))
    worth = min(0.5 * np.median(effective), ratio.size)
    log_z, log_z_error = bridge.log_evidence(ratio.reshape(len(others), -1), weighted.log_weights, worth)
    shape = weighted.pareto_shape
    apart = np.abs(of_points[0] - quantiles) / np.hypot(of_points[1], errors)

    trusted = weighted.efficiency > TRUSTED_EFFICIENCY and shape < TRUSTED_SHAPE
    better = trusted and np.mean(of_points[1] ** 2) < np.mean(errors**2)
    stated = of_points if better or (trusted and memory > FORGETFUL) else (quantiles, errors)
    return {
        "labels": target.labels,
        "method": "importance sampling" if stated is of_points else "chains",
        "quantiles_5_50_95": stated[0].tolist(),
        "quantile_se": stated[1].tolist(),
        "log_evidence": log_z,
        "log_evidence_se": log_z_error,
        "chains": {
            "number": CHAINS,
            "draws": int(draws.shape[1]),
            "gradients": int(gradients),
            "effective_least": float(effective.min()),
            "effective_median": float(np.median(effective)),
            "gradients_per_effective": float(gradients / np.median(effective)),
            "r_hat": r_hat,
            "memory": memory,
        },
        "importance": {
            "points": len(weighted.log_weights),
            "components": len(mixture.weights),
            "efficiency": float(weighted.efficiency),
            "pareto_shape": shape,
            "log_evidence": weighted.log_evidence[0],
            "log_evidence_se": weighted.log_evidence[1],
        },
        "largest_difference_in_se": float(apart.max()),
        "note": remarks(memory, r_hat, apart if trusted else 0.0 * apart, stated is of_points),
    }


def remarks(memory, r_hat, apart, from_importance):
    """What to know before trusting the answer."""
    said = []
    if memory > FORGETFUL:
        said.append(f"Chains stay where they start (correlation {memory:.2f}): there are several modes.")
    if r_hat > SHORT and not from_importance:
        said.append(f"Short chains (R-hat {r_hat:.2f}): the answer and its errors are rough.")
    if apart.max() > 4.5:
        other = "the chains" if from_importance else "importance sampling"
        said.append(f"A quantile of {other} lies {apart.max():.1f} standard errors away.")
    return " ".join(said)
