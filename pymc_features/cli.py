"""The command `pymc-features`.

Most of it is imported when Ctrl-C is looked after, for that takes seconds.
"""

import atexit
import json
import logging
import os
import signal
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pymc_features
from pymc_features.progress import EXIT_INTERRUPTED, CtrlC, Heartbeat, PartProgress, started

EXIT_BAD_INPUT, EXIT_UNEXPLAINED = 2, 3
CONFIG = "configuration file, TOML"
FORCE = "start anew: delete the finished parts in the output folder first"
EXECUTOR = (
    "spread populations over this number of processes, or over the Dask cluster whose scheduler has this "
    "address, such as tcp://host:8786; --cores then says how many chains run at once"
)
# what each command needs, with PyMC
NEEDED = {
    "reproduce": "pymc_features.study",
    "update": "pymc_features.update.run",
    "predict": "pymc_features.update.run",
    "report": "pymc_features.update.report.page",  # which needs no PyMC
    "check": "pymc_features.update.problem",
    "init": "pymc_features.update.examples",
    "convert": "pymc_features.io",
    "warm-up": "pymc_features.warm_up",
}


def command() -> int:
    """Run the command in a process of its own. Ctrl-C ends it while it starts, later a second one does."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, CtrlC(ends_process=True, is_starting=True))
        # of those registered, the first runs last: then nothing is left that could take long
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    try:
        return main()
    except KeyboardInterrupt:  # while an error was being said
        os.write(2, b"Interrupted.\n")
        return EXIT_INTERRUPTED


def main(arguments=None) -> int:
    """Run the command; return its exit code."""
    from rich.console import Console

    from pymc_features.exceptions import NoWorkersError
    from pymc_features.update.config.keys import parsed

    options = make_parser().parse_args(arguments)
    console = Console(stderr=True)
    os.environ.setdefault("MPLBACKEND", "Agg")
    try:
        if options.command in ("update", "check", "predict"):
            parsed(options.config)  # a typo is said before seconds of imports
        with Heartbeat(console, "loading") as options.alive:
            import_module(NEEDED[options.command])
            logging.getLogger("pymc").setLevel(logging.WARNING)  # which its import sets
            started()
            options.alive.now(options.command)
            logging.getLogger("pymc_features").handlers = [console_handler(console)]
            logging.getLogger("pymc_features").setLevel(logging.INFO)
            return globals()[options.command.replace("-", "_")](options, console) or 0
    except KeyboardInterrupt:
        out = getattr(options, "out", None)
        kept = f": finished parts are kept in {out}; the same command continues" if out else ""
        say(console, f"Interrupted{kept}.", "yellow")
        return EXIT_INTERRUPTED
    except (ValueError, TypeError, OSError, NoWorkersError) as error:
        if options.traceback:
            raise
        console.print(f"pymc-features: error: {error}", markup=False, soft_wrap=True)
        return EXIT_BAD_INPUT


def console_handler(console) -> logging.Handler:
    """What says on the console whatever is logged, as a sentence."""
    handler = logging.Handler()
    handler.emit = lambda record: say(console, record.getMessage())
    return handler


def say(console, sentence, style=None):
    """A sentence as it is, on one line."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True, style=style)


def make_parser():
    """Return the parser of all commands."""
    import argparse

    import shtab

    parser = argparse.ArgumentParser(
        prog="pymc-features",
        description="Bayesian updating of structural models from measured vibration.",
    )
    version = f"pymc-features {pymc_features.__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version and exit")
    words = "print a script that completes commands, options and files in a shell, and exit"
    shtab.add_argument_to(parser, ["--print-completion"], help=words)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    files = dict.fromkeys(("FILE", "CONFIG", "RESULT", "IN"), shtab.FILE) | {"DIR": shtab.DIRECTORY}

    def command(name, words, description):
        """What adds arguments to a new command."""
        made = commands.add_parser(name, help=words, description=description)

        def add(name, words, **settings):
            action = made.add_argument(name, help=words, **settings)
            if action.metavar in files:
                action.complete = files[action.metavar]

        return add

    add = command(
        "reproduce",
        "run the sampling-rate study of the source, and write its figures and table",
        "Ten-storey chain, linear or with springs that yield, one stiffness factor: NORM, TN, EXP, ABC by "
        "subset simulation, errors correlated in time, and CAL, whose width the residuals decide, at "
        "several sampling steps of the same data. Writes Figs. 1-4 of the source and two more, the loops of "
        "springs that yield, tables with exact quantiles by quadrature beside the sampled ones and a "
        "sentence on each likelihood, and the whole result as netCDF. A stopped run continues.",
    )
    words = (
        "linear: the source's (default; three minutes on two cores), or bouc-wen: the same with hysteretic "
        "springs (four minutes)"
    )
    add("--structure", words, metavar="NAME", default="linear")
    add("--record", "ground motion: PEER AT2, text/CSV or .mat", metavar="FILE")
    add("--units", "units of the record's file: g, m/s^2, cm/s^2, gal, or m/s^2 per unit")
    add("--record-dt", "step of the record [s], if the file is silent", type=float, metavar="S")
    add("--column", "column of the record's file, if it has several")
    add("--out", "output folder (default: reproduce-output[-STRUCTURE][-quick])", metavar="DIR")
    words = (
        "three sampling steps and fewer draws, for a first look; bouc-wen: of the record until 8 s after its "
        "peak (three minutes)"
    )
    add("--quick", words, action="store_true")
    add("--seed", "of noise and samplers (default: 0)", type=int, default=0)
    add("--noise-time", "correlation time of the noise [s] (default: 0, white)", type=float, metavar="S")
    add("--stiffness", "nominal, initial spring stiffness (default: 1800)", type=float, metavar="N/m")
    words = "NORM, TN, EXP, ABC, CN, CN-SIGMA, CN-TAU, CAL (default: all; bouc-wen: the first four)"
    add("--likelihoods", words, nargs="+", metavar="NAME")
    add("--draws", "draws per chain (default: 2000, quick 250; bouc-wen: 1000)", type=int)
    add("--chains", "chains (default: 4, quick 2; bouc-wen: 2)", type=int)
    add("--cores", "processes (default: all processors)", type=int)
    add("--executor", EXECUTOR, type=where, metavar="WHERE")
    add("--force", FORCE, action="store_true")

    add_update(command)
    for made in commands.choices.values():
        made.add_argument("--traceback", action="store_true", help="on an error, show where it came from")
    return parser


def add_update(command) -> None:
    """The commands for measurements of one's own."""
    add = command(
        "update",
        "update a structure with measured channels, and write a report",
        "Reads a configuration (TOML; `pymc-features init` writes a commented one), samples the posterior "
        "under each of its likelihoods, and writes update.nc, table.csv, table.tex, figures and report.html, "
        "one page that needs no other file. A stopped run continues: finished likelihoods are kept.",
    )
    add("config", CONFIG, metavar="CONFIG")
    add("--out", "output folder (default: CONFIG-output beside CONFIG)", metavar="DIR")
    add("--cores", "processes (default: as CONFIG says, or all processors)", type=int)
    add("--executor", EXECUTOR, type=where, metavar="WHERE")
    add("--force", FORCE, action="store_true")
    add("--json", "print verdict, table and findings for scripts", action="store_true")
    add("--fail-on", "exit with 3 if the model does not explain the data", choices=["verdict"])

    add = command(
        "predict",
        "predict other motions with the posterior of a finished update",
        "Reads each [[predict]] of a configuration and the result of its update, and writes bands of "
        "responses and probabilities of exceedance into it. Nothing is sampled, no channel is read.",
    )
    add("config", CONFIG, metavar="CONFIG")
    add("--out", "folder of the result (default: CONFIG-output)", metavar="DIR")

    add = command(
        "report",
        "make the page of a finished update again, from its update.nc alone",
        "Writes report.html from the result that `update` saved, without its data files, without sampling "
        "and within seconds.",
    )
    add("result", "update.nc of an update", metavar="RESULT")
    add("--out", "page (default: report.html beside RESULT)", metavar="FILE")

    add = command(
        "check",
        "look at the data of a configuration without sampling",
        "Reads a configuration and its channels, checks them against each other, says which lines of the "
        "file would correct what is wrong, and draws them.",
    )
    add("config", CONFIG, metavar="CONFIG")
    add("--out", "figure (default: CONFIG-check.png beside CONFIG)", metavar="FILE")
    add(
        "--json",
        "print warnings and whether anything could be checked, for scripts",
        action="store_true",
    )

    add = command(
        "init",
        "write a commented configuration that runs",
        "Writes a configuration for the three-storey shaking-table model, with its measured data if they "
        "are in PYMC_FEATURES_DATA, in the cache or can be downloaded, else with simulated data in a file "
        "beside it. Or for a building of eight storeys with three sensors, simulated.",
    )
    add("config", "file to write (default: update.toml)", metavar="CONFIG", nargs="?", default="update.toml")
    add("--example", "shaking-table (default) or building", metavar="NAME", default="shaking-table")
    add("--synthetic", "shaking-table: simulated data in any case", action="store_true")

    add = command(
        "convert",
        "write the channels or modes of a file into another format",
        "Reads accelerations in any format that is known, or with --modes identified modes, and writes CSV "
        "with units in its header, a Universal File, or modes as JSON, by the ending of OUT.",
    )
    add("source", "file to read", metavar="IN")
    add("target", ".csv, .txt, .uff, .unv, modes also .json", metavar="OUT")
    add("--modes", "IN holds identified modes (JSON always does)", action="store_true")
    add("--units", "of channels, if the file is silent: g, m/s^2, gal, or m/s^2 per unit")
    add("--dt", "step of the channels [s], if the file is silent", type=float, metavar="S")
    add("--force", "replace OUT if it is there", action="store_true")

    command(
        "warm-up",
        "compile ahead what most models need",
        "Samples a small model of each family of structures, so that the first model of yours need not wait: "
        "three minutes, once for a machine and a version. What is compiled is kept on disk.",
    )


def where(text: str) -> int | str:
    """A number of processes, or an address."""
    return int(text) if text.lstrip("-").isdigit() else text


def find_record(options):
    """Return the record to use, and a sentence that says which and why."""
    from pymc_features import datasets, io

    if options.record is None:
        record = datasets.el_centro()
        return record, f"record: {record}"
    units, column = number(options.units), options.column
    if column is not None and column.isdigit():
        column = int(column)
    record = io.read_record(options.record, units=units, dt=options.record_dt, column=column)
    return record, f"record: {record} from {options.record}"


def number(text: str | None) -> float | str | None:
    """A text as a number, if it is one."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return text


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
    for name in ("draws", "chains", "cores", "executor", "likelihoods", "noise_time"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    forget_parts(options, "study", console)
    with PartProgress(console, "study", options.alive, pause=3.0) as progress:
        result = sampling_rate_study(
            record,
            structure=described,
            random_seed=options.seed,
            out=options.out,
            progress=lambda part, done, total: progress(part, done, total + 1),
            progressbar=False,
            **settings,
        )
        sizes = result["summary"].sizes
        parts = (sizes["likelihood"] + 1) * sizes["multiplier"]
        progress("figures and tables", parts, parts + 1)
        paths = write_outputs(result, options.out)
        progress("finished", parts + 1, parts + 1)
    if sentence := yielding(result):
        say(console, f"springs: {sentence}")
    for path in paths:
        say(console, f"wrote {path}")


def update(options, console):
    """Update a structure as a configuration says, and write the report."""
    from pymc_features.update import run_update, write_outputs
    from pymc_features.update.report.document import as_json, document_of, summary

    config = Path(options.config)
    options.out = Path(options.out or config.with_name(f"{config.stem}-output"))
    problem, told = read_and_tell(config, console)
    for sentence in problem.measured.foretold(problem) if problem.measured else ():
        say(console, f"note: {sentence}")
    forget_parts(options, "update", console)
    with PartProgress(console, "update", options.alive) as progress:
        result = run_update(
            problem,
            out=options.out,
            cores=options.cores,
            executor=options.executor,
            progress=progress,
            progressbar=console.is_terminal,
        )
    document = document_of(problem, result, told)
    result.attrs["document"] = json.dumps(document)
    for part, style in summary(document):
        if isinstance(part, str):
            say(console, part, style)
        else:
            console.print(part)
    for path in write_outputs(problem, result, options.out):
        if path.parent == options.out:
            say(console, f"wrote {path}")
    if options.json:
        print(as_json(document))
    return EXIT_UNEXPLAINED if options.fail_on == "verdict" and not document["verdict"]["explains"] else 0


def predict(options, console):
    """Predict other motions with the posterior of a finished update."""
    from pymc_features.storage import netcdf_bytes, write_atomically
    from pymc_features.update.predictions import predicted_rows, predicted_table
    from pymc_features.update.report.document import drawn_table, put_predictions
    from pymc_features.update.report.outputs import predict_stored
    from pymc_features.update.report.page import write_page

    config = Path(options.config)
    out = Path(options.out or config.with_name(f"{config.stem}-output"))
    result = predict_stored(config, out / "update.nc")
    console.print(drawn_table(predicted_table(predicted_rows(result))))
    put_predictions(result)
    write_atomically(out / "update.nc", lambda path: path.write_bytes(netcdf_bytes(result)))
    for path in (out / "update.nc", write_page(out / "update.nc")):
        say(console, f"wrote {path}")


def report(options, console):
    """Make the page of a saved update again."""
    from pymc_features.update.report.page import write_page

    say(console, f"wrote {write_page(options.result, options.out)}")


def forget_parts(options, what, console):
    """With --force, delete the finished parts in the output folder."""
    from pymc_features.storage import remove_parts

    if not options.force:
        return
    n = remove_parts(options.out, what)
    for folder in (options.out / "sequence").glob("*/"):
        n += remove_parts(folder, "sequence")
    if n:
        say(console, f"deleted {n} finished part{'s' if n > 1 else ''} in {options.out}")


def read_and_tell(config, console):
    """The problem of a configuration, and what was said about its channels."""
    import warnings

    from pymc_features.update import read_problem

    told = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        try:
            problem = read_problem(config)
            problem.modal  # noqa: B018 - of ambient vibration they are identified now
        finally:  # what was found before an error may be its cause
            told += dict.fromkeys(str(warning.message) for warning in caught)
            for sentence in told:
                say(console, f"warning: {sentence}", "yellow")
    if problem.structure.has_modes:
        say(console, problem.sentence)
    for data in problem.shown:
        tell(data.told(), console)
    return problem, told


def tell(shown, console):
    """Print sentences and tables."""
    from pymc_features.update.report.document import drawn_table

    for one in shown:
        if isinstance(one, str):
            say(console, one)
        else:
            console.print(drawn_table(one))


def check(options, console):
    """Look at the data of a configuration."""
    from pymc_features.update.run import candidates_of, members_of

    config = Path(options.config)
    problem, told = read_and_tell(config, console)
    out = Path(options.out or config.with_name(f"{config.stem}-check.png"))
    for data in problem.shown:
        path = out if data is problem.first else out.with_name(f"{out.stem}-modes{out.suffix}")
        tell(data.check(problem, path), console)
    candidates_of(problem)  # errors of which are found now
    members_of(problem)
    if problem.config.sensitivity is not None:
        from pymc_features.update.sensitivity import remaining, sensitivity_sentences

        tell(sensitivity_sentences(remaining(problem)), console)
    checked = any(data.is_checked for data in problem.shown)
    if options.json:
        print(json.dumps({"checked": checked, "warnings": told}))
    if not told and checked:
        say(console, "nothing was found wrong")
    elif not told and problem.structure.has_modes:
        say(console, "nothing could be checked, so that nothing is known of what is wrong")


def init(options, console):
    """Write an example of a configuration."""
    from pymc_features.update import write_example

    paths, sentence = write_example(options.config, example=options.example, synthetic=options.synthetic)
    for line in (sentence, *(f"wrote {path}" for path in paths), f"run: pymc-features update {paths[0]}"):
        say(console, line)


def convert(options, console):
    """Write channels or modes of one file into another."""
    source, target = Path(options.source), Path(options.target)
    if target.exists() and not options.force:
        raise ValueError(f"`OUT` must be a new file, {target} is there. Pass --force to replace it.")
    if options.modes or ".json" in (source.suffix.lower(), target.suffix.lower()):
        from pymc_features.modal.files import read_modal
        from pymc_features.modal.files.write import write_modal

        modal = read_modal(source, real=False)
        write_modal(modal, target)
        say(console, f"wrote {modal} to {target}")
        return
    from pymc_features.io import read_channels_with_gaps
    from pymc_features.io.write import write_channels

    channels = read_channels_with_gaps(source, units=number(options.units), dt=options.dt)
    write_channels(channels, target)
    names = ", ".join(channels["sensor"].values.tolist())
    say(console, f"wrote {names}, {channels.sizes['time']} samples in {channels.attrs['units']}, to {target}")


def warm_up(options, console):
    """Compile ahead what most models need."""
    from pymc_features.warm_up import warm_up

    with PartProgress(console, "compiling", options.alive) as progress:
        warm_up(progress)


def strong_part(record, seconds: float):
    """The record until some seconds after its peak, with a name that says so."""
    end = record.time[abs(record.acceleration).argmax()] + seconds
    kept = record.acceleration[record.time <= end]
    if kept.size == record.n_times:
        return record
    return replace(record, acceleration=kept, name=f"{record.name}, first {kept.size * record.dt:.3g} s")


def default_folder(options) -> str:
    """Name the folder of a study that was given none; the linear one has no name, for it came first."""
    parts = ["reproduce-output"]
    if options.structure != "linear":
        parts.append(options.structure)
    return "-".join([*parts, "quick"] if options.quick else parts)


if __name__ == "__main__":
    sys.exit(command())
