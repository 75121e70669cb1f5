"""The command `pymc-features`.

Most of it is imported when Ctrl-C is looked after, for that takes seconds.
"""

import atexit
import logging
import os
import signal
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from pymc_features.interrupt import EXIT_INTERRUPTED, CtrlC, started

EXIT_BAD_INPUT, EXIT_UNEXPLAINED = 2, 3
# what each command needs, with PyMC
NEEDED = {"update": "pymc_features.update.run", "check": "pymc_features.update.report.terminal"}
NEEDED |= {"predict": "pymc_features.update.run", "report": "pymc_features.update.report.page"}
NEEDED |= {"init": "pymc_features.update.examples.write"}
NEEDED |= {"reproduce": "pymc_features.study", "convert": "pymc_features.io"}
NEEDED["report"] = "pymc_features.update.report.page"  # which needs no PyMC


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

    from pymc_features.arguments import make_parser
    from pymc_features.exceptions import NoWorkersError
    from pymc_features.progress import Heartbeat
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
            logging.getLogger("pymc_features").addHandler(Told(console))
            logging.getLogger("pymc_features").setLevel(logging.INFO)
            commands = {"reproduce": reproduce, "update": update, "predict": predict, "report": report}
            commands |= {"check": check, "init": init, "convert": convert}
            return commands[options.command](options, console) or 0
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


class Told(logging.Handler):
    """What is logged, as a sentence on the console."""

    def __init__(self, console):
        super().__init__()
        self.console = console

    def emit(self, record):
        """Say it."""
        say(self.console, record.getMessage())


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
    from pymc_features.progress import PartProgress
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
    from pymc_features.progress import PartProgress
    from pymc_features.update import run_update, write_outputs
    from pymc_features.update.report.findings import as_json, findings
    from pymc_features.update.report.terminal import summary

    config = Path(options.config)
    options.out = Path(options.out or config.with_name(f"{config.stem}-output"))
    problem, told = read_and_tell(config, console)
    for sentence in problem.first.foretold(problem):
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
    found = findings(problem, result)
    for part, style in summary(found):
        if isinstance(part, str):
            say(console, part, style)
        else:
            console.print(part)
    for path in write_outputs(problem, result, options.out, told, found):
        if path.parent == options.out:
            say(console, f"wrote {path}")
    if options.json:
        print(as_json(found))
    return EXIT_UNEXPLAINED if options.fail_on == "verdict" and not found.verdict.explains else 0


def predict(options, console):
    """Predict other motions with the posterior of a finished update."""
    import json

    from pymc_features.storage import netcdf_bytes, write_atomically
    from pymc_features.update.predictions import predicted_rows
    from pymc_features.update.report.document import table_of_predictions, with_predictions
    from pymc_features.update.report.page import write_page
    from pymc_features.update.report.terminal import drawn_table
    from pymc_features.update.run import predict_stored

    config = Path(options.config)
    out = Path(options.out or config.with_name(f"{config.stem}-output"))
    result = predict_stored(config, out / "update.nc")
    console.print(drawn_table(table_of_predictions(predicted_rows(result))))
    result.attrs["document"] = json.dumps(with_predictions(json.loads(result.attrs["document"]), result))
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
    from pymc_features.update.kinds.expected import structure_sentence

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
        say(console, structure_sentence(problem))
    for data in problem.data:
        tell(data.told(), console)
    return problem, told


def tell(shown, console):
    """Print sentences and tables."""
    from pymc_features.update.report.terminal import drawn_table

    for one in shown:
        if isinstance(one, str):
            say(console, one)
        else:
            console.print(drawn_table(one))


def check(options, console):
    """Look at the data of a configuration."""
    from pymc_features.update.candidates import candidates_of
    from pymc_features.update.population import members_of

    config = Path(options.config)
    problem, told = read_and_tell(config, console)
    out = Path(options.out or config.with_name(f"{config.stem}-check.png"))
    for data in problem.data:
        path = out if data is problem.first else out.with_name(f"{out.stem}-modes{out.suffix}")
        tell(data.check(problem, path), console)
    candidates_of(problem)  # errors of which are found now
    members_of(problem)
    if problem.config.sensitivity is not None:
        from pymc_features.update.sensitivity import remaining, sensitivity_sentences

        tell(sensitivity_sentences(remaining(problem)), console)
    if not told and any(data.is_checked for data in problem.data):
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

    units = float(options.units) if _is_number(options.units or "") else options.units
    channels = read_channels_with_gaps(source, units=units, dt=options.dt)
    write_channels(channels, target)
    names = ", ".join(channels["sensor"].values.tolist())
    say(console, f"wrote {names}, {channels.sizes['time']} samples in {channels.attrs['units']}, to {target}")


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
