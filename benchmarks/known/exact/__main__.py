"""Command line: `python -m benchmarks.known.exact NAME...`."""

import argparse
import time
import warnings
import zlib

import numpy as np

from benchmarks.known import STRUCTURAL_NAMES
from benchmarks.known.exact import chains, grid
from benchmarks.known.exact.chains_and_importance import answer
from benchmarks.known.exact.scores import NormalScores
from benchmarks.known.saved import entries, save
from benchmarks.known.structural import LIKELIHOODS, declare
from benchmarks.known.targets import logistic

PARTICLES = {True: 128, False: 256}  # with quadrature they only tell where the posterior lies


def model_of(name):
    """The model whose answer is wanted."""
    kind, d, *_ = name.split("-")
    return declare(name) if kind in LIKELIHOODS else logistic.declare(int(d))


def solve(name, minutes, seed):
    """Entry of `answers.json`, and the particles that tempering ended with."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    target = NormalScores(model_of(name))
    start = time.perf_counter()
    by_quadrature = target.d <= 1 + max(grid.CELLS)
    now, moves, log_z = chains.tempered(target, PARTICLES[by_quadrature], rng)
    print(f"{name}: tempered in {time.perf_counter() - start:.0f} s, log evidence {log_z:.3f}", flush=True)
    of_grid = grid.answer(target, now.z) if by_quadrature else None
    entry = of_grid or answer(target, now, moves, rng, 60.0 * minutes)
    entry["log_evidence_tempered"] = float(log_z)
    entry["seconds"] = round(time.perf_counter() - start, 1)
    return entry


def main():
    """Solve the posteriors asked for, one after another."""
    parser = argparse.ArgumentParser("python -m benchmarks.known.exact", description=__doc__)
    parser.add_argument(
        "names", nargs="+", metavar="NAME", help=f"such as {STRUCTURAL_NAMES[0]} or logistic-10"
    )
    parser.add_argument(
        "--minutes", type=float, default=3.0, help="of the processor, for the chains of each posterior"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", action="store_true", help="also those that are there")
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore")
    for name in arguments.names:
        if name in entries() and not arguments.again:
            print(f"{name}: is there", flush=True)
            continue
        entry = solve(name, arguments.minutes, arguments.seed)
        save(name, entry)
        told = f"{entry['log_evidence']:.4f} +- {entry['log_evidence_se']:.4f}"
        print(f"{name}: {entry['seconds']:.0f} s, log evidence {told}. {entry['note']}", flush=True)


if __name__ == "__main__":
    main()
