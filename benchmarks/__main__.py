"""Command line of the benchmarks: `python -m benchmarks`."""

import argparse
import os
import platform
import time
import warnings
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

SECTIONS = ("evaluation", "gradients", "ambient", "posteriors", "abc", "scaling", "structures")
# run only if asked for
LONG = ("dimensions", "targets", "ablation", "coverage", "opensees", "events", "cluster", "emulation")
HELP = f"run one section; all but {', '.join(LONG)} by default (20 minutes)"
PACKAGES = (
    *("pymc-features", "pymc", "pytensor", "numba", "numpy", "scipy"),
    *("jax", "blackjax", "numpyro", "ultranest", "dynesty", "smcpy", "parallel-abus"),
    *("pyabc", "sbi", "torch", "nutpie", "diffrax", "openseespy"),
)


def environment():
    """One line about the processor, one about the versions."""
    processor = platform.processor() or platform.machine()
    if (cpuinfo := Path("/proc/cpuinfo")).exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        processor = names[0].split(":", 1)[1].strip() if names else processor
    found = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} not installed")
    return f"{processor}, one thread\n{', '.join(found)}"


def confine():
    """Stay on one processor where the system allows: limits set by variables do not bind every library."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def main():
    """Run the sections asked for and print their tables."""
    parser = argparse.ArgumentParser("python -m benchmarks", description="Cost and accuracy, side by side.")
    parser.add_argument("--only", choices=SECTIONS + LONG, help=HELP)
    parser.add_argument("--quick", action="store_true", help="fewer rounds and seeds (five minutes)")
    parser.add_argument("--names", nargs="+", metavar="NAME", help="problems, or parts of coverage")
    parser.add_argument(
        "--keep", metavar="FILE", help="keep events of 'model errors' there, and go on from it"
    )
    arguments = parser.parse_args()
    if arguments.names and arguments.only not in LONG:
        parser.error(f"--names needs --only {' or '.join(LONG)}")
    if arguments.keep and arguments.only != "coverage":
        parser.error("--keep needs --only coverage")
    warnings.filterwarnings("ignore")
    confine()
    print(environment(), flush=True)
    start, cpu_start = time.perf_counter(), time.process_time()
    for section in [arguments.only] if arguments.only else SECTIONS:
        asked = {"names": arguments.names, "keep": arguments.keep}
        named = {name: value for name, value in asked.items() if value}
        import_module(f"benchmarks.{section}").run(arguments.quick, **named)
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    print(f"\n{seconds:.0f} s in all, {100.0 * cpu_seconds / seconds:.0f} % of them on the processor.")
    if cpu_seconds < 0.95 * seconds:
        print("The machine was busy with other work: trust the ratios more than the seconds.")


if __name__ == "__main__":
    main()
