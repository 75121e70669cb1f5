"""The arguments of the command `pymc-features`."""

import argparse

import shtab

import pymc_features

FORCE = "start anew: delete the finished parts in the output folder first"
EXECUTOR = (
    "spread populations over this number of processes, or over the Dask cluster whose scheduler has this "
    "address, such as tcp://host:8786; --cores then says how many chains run at once"
)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="pymc-features",
        description="Bayesian updating of structural models from measured vibration.",
    )
    version = f"pymc-features {pymc_features.__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version and exit")
    words = "print a script that completes commands, options and files in a shell, and exit"
    shtab.add_argument_to(parser, ["--print-completion"], help=words)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    study = commands.add_parser(
        "reproduce",
        help="run the sampling-rate study of the source, and write its figures and table",
        description="Ten-storey chain, linear or with springs that yield, one stiffness factor: NORM, TN, "
        "EXP, ABC by subset simulation, errors correlated in time, and CAL, whose width the residuals "
        "decide, at several sampling steps of the same data. Writes Figs. 1-4 of the source and two more, "
        "the loops of springs that yield, tables with exact quantiles by quadrature beside the sampled ones "
        "and a sentence on each likelihood, and the whole result as netCDF. A stopped run continues.",
    )
    add = study.add_argument
    add(
        "--structure",
        metavar="NAME",
        default="linear",
        help="linear: the source's (default; three minutes on two cores), or bouc-wen: the same with "
        "hysteretic springs (four minutes)",
    )
    add("--record", metavar="FILE", help="ground motion: PEER AT2, text/CSV or .mat").complete = shtab.FILE
    add("--units", help="units of the record's file: g, m/s^2, cm/s^2, gal, or m/s^2 per unit")
    add("--record-dt", type=float, metavar="S", help="step of the record [s], if the file is silent")
    add("--column", help="column of the record's file, if it has several")
    add(
        "--out", metavar="DIR", help="output folder (default: reproduce-output[-STRUCTURE][-quick])"
    ).complete = shtab.DIRECTORY
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
    add("--executor", type=executor, metavar="WHERE", help=EXECUTOR)
    add(
        "--force",
        action="store_true",
        help=FORCE,
    )
    add("--traceback", action="store_true", help="on an error, show where it came from")
    add_update(commands)
    return parser


def executor(text: str) -> int | str:
    """A number of processes, or an address."""
    return int(text) if text.lstrip("-").isdigit() else text


def add_update(commands):
    """The commands for measurements of one's own."""
    run = commands.add_parser(
        "update",
        help="update a structure with measured channels, and write a report",
        description="Reads a configuration (TOML; `pymc-features init` writes a commented one), samples the "
        "posterior under each of its likelihoods, and writes update.nc, table.csv, table.tex, figures and "
        "report.html, one page that needs no other file. A stopped run continues: finished likelihoods are "
        "kept.",
    )
    run.add_argument("config", metavar="CONFIG", help="configuration file, TOML").complete = shtab.FILE
    run.add_argument(
        "--out", metavar="DIR", help="output folder (default: CONFIG-output beside CONFIG)"
    ).complete = shtab.DIRECTORY
    run.add_argument("--cores", type=int, help="processes (default: as CONFIG says, or all processors)")
    run.add_argument("--executor", type=executor, metavar="WHERE", help=EXECUTOR)
    run.add_argument(
        "--force",
        action="store_true",
        help=FORCE,
    )
    run.add_argument("--json", action="store_true", help="print verdict, table and findings for scripts")
    run.add_argument(
        "--fail-on", choices=["verdict"], help="exit with 3 if the model does not explain the data"
    )
    ahead = commands.add_parser(
        "predict",
        help="predict other motions with the posterior of a finished update",
        description="Reads each [[predict]] of a configuration and the result of its update, and writes "
        "bands of responses and probabilities of exceedance into it. Nothing is sampled, no channel is read.",
    )
    ahead.add_argument("config", metavar="CONFIG", help="configuration file, TOML").complete = shtab.FILE
    ahead.add_argument(
        "--out", metavar="DIR", help="folder of the result (default: CONFIG-output)"
    ).complete = shtab.DIRECTORY
    page = commands.add_parser(
        "report",
        help="make the page of a finished update again, from its update.nc alone",
        description="Writes report.html from the result that `update` saved, without its data files, without "
        "sampling and within seconds.",
    )
    page.add_argument("result", metavar="RESULT", help="update.nc of an update").complete = shtab.FILE
    page.add_argument("--out", metavar="FILE", help="page (default: report.html beside RESULT)")
    look = commands.add_parser(
        "check",
        help="look at the data of a configuration without sampling",
        description="Reads a configuration and its channels, checks them against each other, says which "
        "lines of the file would correct what is wrong, and draws them.",
    )
    look.add_argument("config", metavar="CONFIG", help="configuration file, TOML").complete = shtab.FILE
    look.add_argument("--out", metavar="FILE", help="figure (default: CONFIG-check.png beside CONFIG)")
    example = commands.add_parser(
        "init",
        help="write a commented configuration that runs",
        description="Writes a configuration for the three-storey shaking-table model, with its measured data "
        "if they are in PYMC_FEATURES_DATA, in the cache or can be downloaded, else with simulated data in a "
        "file beside it. Or for a building of eight storeys with three sensors, simulated.",
    )
    example.add_argument("config", metavar="CONFIG", nargs="?", default="update.toml")
    example.add_argument(
        "--example", metavar="NAME", default="shaking-table", help="shaking-table (default) or building"
    )
    example.add_argument("--synthetic", action="store_true", help="shaking-table: simulated data in any case")
    change = commands.add_parser(
        "convert",
        help="write the channels or modes of a file into another format",
        description="Reads accelerations in any format that is known, or with --modes identified modes, and "
        "writes CSV with units in its header, a Universal File, or modes as JSON, by the ending of OUT.",
    )
    change.add_argument("source", metavar="IN", help="file to read").complete = shtab.FILE
    change.add_argument("target", metavar="OUT", help=".csv, .txt, .uff, .unv, modes also .json")
    change.add_argument("--modes", action="store_true", help="IN holds identified modes (JSON always does)")
    change.add_argument(
        "--units", help="of channels, if the file is silent: g, m/s^2, gal, or m/s^2 per unit"
    )
    change.add_argument(
        "--dt", type=float, metavar="S", help="step of the channels [s], if the file is silent"
    )
    change.add_argument("--force", action="store_true", help="replace OUT if it is there")
    for command in (run, ahead, page, look, example, change):
        command.add_argument("--traceback", action="store_true", help="on an error, show where it came from")
