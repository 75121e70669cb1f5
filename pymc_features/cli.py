"""The command `pymc-features`."""

import argparse
import atexit
import logging
import os
import signal
import sys
from pathlib import Path

from rich.console import Console

from pymc_features.progress import EXIT_INTERRUPTED, CtrlC, PartProgress

EXIT_BAD_INPUT = 2


def command() -> int:
    """Run the command in a process of its own, which a second Ctrl-C ends at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, CtrlC(ends_process=True))
        # of those registered, the first runs last: then nothing is left that could take long
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    return main()


def main(arguments=None) -> int:
    """Run the command; return its exit code."""
    options = make_parser().parse_args(arguments)
    console = Console(stderr=True)
    logging.getLogger("pymc").setLevel(logging.WARNING)
    os.environ.setdefault("MPLBACKEND", "Agg")
    try:
        options.run(options, console)
    except KeyboardInterrupt:
        out = getattr(options, "out", None)
        kept = f": finished parts are kept in {out}; the same command continues" if out else ""
        say(console, f"interrupted{kept}.", "yellow")
        return EXIT_INTERRUPTED
    except (ValueError, TypeError, OSError) as error:
        if options.traceback:
            raise
        console.print(f"pymc-features: error: {error}", markup=False, soft_wrap=True)
        return EXIT_BAD_INPUT
    return 0


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="pymc-features",
        description="Bayesian updating of structural models from measured vibration.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    study = commands.add_parser(
        "reproduce",
        help="run the sampling-rate study of the source, and write its figures and table",
        description="Ten-storey chain, linear or with springs that yield, one stiffness factor: NORM, TN, "
        "EXP, ABC by subset simulation, errors correlated in time, and CAL, whose width the residuals "
        "decide, at several sampling steps of the same data. Writes Figs. 1-4 of the source and two more, "
        "the loops of springs that yield, tables with exact quantiles by quadrature beside the sampled ones "
        "and a sentence on each likelihood, and the whole result as netCDF. A stopped run continues.",
    )
    study.set_defaults(run=reproduce)
    add = study.add_argument
    add(
        "--structure",
        metavar="NAME",
        default="linear",
        help="linear: the source's (default; three minutes on two cores), or bouc-wen: the same with "
        "hysteretic springs (most of an hour)",
    )
    add("--record", metavar="FILE", help="ground motion: PEER AT2, text/CSV or .mat")
    add("--units", help="units of the record's file: g, m/s^2, cm/s^2, gal, or m/s^2 per unit")
    add("--record-dt", type=float, metavar="S", help="step of the record [s], if the file is silent")
    add("--column", help="column of the record's file, if it has several")
    add("--out", metavar="DIR", help="output folder (default: reproduce-output[-STRUCTURE][-quick])")
    add(
        "--quick",
        action="store_true",
        help="three sampling steps and fewer draws, for a first look; bouc-wen: of the record until 8 s "
        "after its peak (three minutes)",
    )
    add("--seed", type=int, default=0, help="of noise and samplers (default: 0)")
    add(
        "--noise-time",
        type=float,
        metavar="S",
        help="correlation time of the noise [s] (default: 0, white)",
    )
    add("--stiffness", type=float, metavar="N/m", help="nominal, initial spring stiffness (default: 1800)")
    add(
        "--likelihoods",
        nargs="+",
        metavar="NAME",
        help="NORM, TN, EXP, ABC, CN, CN-SIGMA, CN-TAU, CAL (default: all; bouc-wen: the first four)",
    )
    add("--draws", type=int, help="draws per chain (default: 2000, quick 250; bouc-wen: 1000)")
    add("--chains", type=int, help="chains (default: 4, quick 2; bouc-wen: 2)")
    add("--cores", type=int, help="processes (default: all processors)")
    add("--traceback", action="store_true", help="on an error, show where it came from")
    add_update(commands)
    return parser


def add_update(commands):
    """The commands for measurements of one's own."""
    run = commands.add_parser(
        "update",
        help="update a structure with measured channels, and write a report",
        description="Reads a configuration (TOML; `pymc-features init` writes a commented one), samples the "
        "posterior under each of its likelihoods, and writes update.nc, table.csv, figures and report.html, "
        "one page that needs no other file. A stopped run continues: finished likelihoods are kept.",
    )
    run.set_defaults(run=update)
    run.add_argument("config", metavar="CONFIG", help="configuration file, TOML")
    run.add_argument("--out", metavar="DIR", help="output folder (default: CONFIG-output beside CONFIG)")
    run.add_argument("--cores", type=int, help="processes (default: as CONFIG says, or all processors)")
    look = commands.add_parser(
        "check",
        help="look at the data of a configuration without sampling",
        description="Reads a configuration and its channels, checks them against each other, says which "
        "lines of the file would correct what is wrong, and draws them.",
    )
    look.set_defaults(run=check)
    look.add_argument("config", metavar="CONFIG", help="configuration file, TOML")
    look.add_argument("--out", metavar="FILE", help="figure (default: CONFIG-check.png beside CONFIG)")
    example = commands.add_parser(
        "init",
        help="write a commented configuration that runs",
        description="Writes a configuration for the three-storey shaking-table model, with its measured data "
        "if they are in PYMC_FEATURES_DATA, in the cache or can be downloaded, else with simulated data in a "
        "file beside it.",
    )
    example.set_defaults(run=init)
    example.add_argument("config", metavar="CONFIG", nargs="?", default="update.toml")
    example.add_argument("--synthetic", action="store_true", help="simulated data in any case")
    for command in (run, look, example):
        command.add_argument("--traceback", action="store_true", help="on an error, show where it came from")


def say(console, sentence, style=None):
    """A sentence as it is, on one line."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True, style=style)


def find_record(options):
    """Return the record to use, and a sentence that says which and why."""
    from pymc_features import datasets, io

    if options.record is not None:
        units, column = options.units, options.column
        if units is not None and _is_number(units):
            units = float(units)
        if column is not None and column.isdigit():
            column = int(column)
        record = io.read_record(options.record, units=units, dt=options.record_dt, column=column)
        return record, f"record: {record} from {options.record}"
    record = datasets.el_centro()
    return record, f"record: {record}"


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def reproduce(options, console):
    """Run the study and write figures, table and result."""
    from pymc_features.study import find_structure, sampling_rate_study, write_outputs, yielding

    of_springs = {} if options.stiffness is None else {"stiffness": options.stiffness}
    described = find_structure(options.structure, **of_springs)
    options.out = Path(options.out or default_folder(options))
    record, sentence = find_record(options)
    say(console, sentence)
    if options.quick and described.quick_seconds is not None:
        record = strong_part(record, described.quick_seconds)
        say(console, f"used: {record}")
    settings = dict(described.quick) if options.quick else {}
    for name in ("draws", "chains", "cores", "likelihoods", "noise_time"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    with PartProgress(console, "study") as progress:
        result = sampling_rate_study(
            record,
            structure=described,
            random_seed=options.seed,
            out=options.out,
            progress=progress,
            progressbar=console.is_terminal,
            **settings,
        )
    if sentence := yielding(result):
        say(console, f"springs: {sentence}")
    for path in write_outputs(result, options.out):
        say(console, f"wrote {path}")


def update(options, console):
    """Update a structure as a configuration says, and write the report."""
    from pymc_features.update import run_update, write_outputs
    from pymc_features.update.report.terminal import summary
    from pymc_features.update.report.verdict import foretold

    config = Path(options.config)
    options.out = Path(options.out or config.with_name(f"{config.stem}-output"))
    problem, told = read_and_tell(config, console)
    for sentence in foretold(problem):
        say(console, f"note: {sentence}")
    with PartProgress(console, "update") as progress:
        result = run_update(
            problem,
            out=options.out,
            cores=options.cores,
            progress=progress,
            progressbar=console.is_terminal,
        )
    for part, style in summary(problem, result):
        if isinstance(part, str):
            say(console, part, style)
        else:
            console.print(part)
    for path in write_outputs(problem, result, options.out, told):
        if path.parent == options.out:
            say(console, f"wrote {path}")


def read_and_tell(config, console):
    """The problem of a configuration, and what was said about its channels."""
    import warnings

    from pymc_features.update import read_problem

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        problem = read_problem(config)
    told = list(dict.fromkeys(str(warning.message) for warning in caught))
    for sentence in told:
        say(console, f"warning: {sentence}", "yellow")
    measured = problem.measured
    say(console, f"data: {measured.source}; base: {measured.record}")
    say(console, f"channels: {measured.checked.sentence}")
    return problem, told


def check(options, console):
    """Look at the data of a configuration."""
    from pymc_features import plots
    from pymc_features.storage import write_atomically
    from pymc_features.update.problem.channels import base_and_sensors
    from pymc_features.update.report.terminal import gains_table

    config = Path(options.config)
    problem, told = read_and_tell(config, console)
    if problem.measured.checked.gains is not None:
        console.print(gains_table(problem.measured.checked.gains))
    out = Path(options.out or config.with_name(f"{config.stem}-check.png"))
    axes = plots.plot_channels(base_and_sensors(problem.measured))
    write_atomically(out, lambda path: axes[0].figure.savefig(path, dpi=120, format="png"))
    plots.close(axes[:1])
    say(console, f"wrote {out}")
    if not told:
        say(console, "nothing was found wrong")


def init(options, console):
    """Write an example of a configuration."""
    from pymc_features.update import write_example

    paths, sentence = write_example(options.config, synthetic=options.synthetic)
    for line in (sentence, *(f"wrote {path}" for path in paths), f"run: pymc-features update {paths[0]}"):
        say(console, line)


def strong_part(record, seconds: float):
    """The record until some seconds after its peak, with a name that says so."""
    from pymc_features import Record

    end = record.time[abs(record.acceleration).argmax()] + seconds
    kept = record.acceleration[record.time <= end]
    if kept.size == record.n_times:
        return record
    return Record(kept, record.dt, name=f"{record.name}, first {kept.size * record.dt:.3g} s")


def default_folder(options) -> str:
    """Where a study goes that was given no folder; the linear one has no name, for it came first."""
    parts = ["reproduce-output"]
    if options.structure != "linear":
        parts.append(options.structure)
    return "-".join([*parts, "quick"] if options.quick else parts)


if __name__ == "__main__":
    sys.exit(command())
