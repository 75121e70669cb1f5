"""Configurations for files as loggers write them: the channels are the motion whatever they look like."""

import datetime

import numpy as np
import pytest
from scipy import signal

import pymc_features as pmf
from pymc_features.cli import main
from pymc_features.io.reading.labels import G
from pymc_features.update import read_problem
from pymc_features.update.kinds.base import declare

STEP, N = 0.005, 3000
TIME = STEP * np.arange(N)
RNG = np.random.default_rng(5)
SHAKEN = np.sin(np.pi * np.clip(TIME / 12.0, 0.0, 1.0)) ** 2
FILTER = signal.butter(4, [0.3, 12.0], "bandpass", fs=1.0 / STEP, output="sos")
BASE = 3.0 * SHAKEN * signal.sosfiltfilt(FILTER, RNG.normal(size=N))
CHAIN = pmf.SpringMassChain(1000.0 * np.ones(3), [1.8e6, 1.6e6, 1.4e6], pmf.ModalDamping(0.03))
FLOORS = pmf.simulate(CHAIN, pmf.Record(BASE, STEP)).values
DRIFT = pmf.simulate(CHAIN, pmf.Record(BASE, STEP), quantity="relative_displacement").values
TAIL = """
[structure]
type = "SpringMassChain"
n = 3
mass = 1000.0
stiffness = ["k1", 1.6e6, 1.4e6]
damping = {type = "ModalDamping", ratios = 0.03}
[priors]
k1 = {distribution = "LogNormal", mu = 14.4, sigma = 0.3}
[likelihood]
kinds = ["EXP"]
sigma = SIGMA
"""


def stamps(folder):
    """Dates that pass midnight and New Year, g."""
    start = datetime.datetime(2023, 12, 31, 23, 59, 55)
    rows = ["Timestamp,base [g],floor 1 [g],floor 2 [g],roof [g]"]
    for k in range(N):
        moment = (start + datetime.timedelta(microseconds=5000 * k)).isoformat(timespec="milliseconds")
        rows.append(",".join([moment, *(f"{x / G:.8f}" for x in (BASE[k], *FLOORS[:, k]))]))
    (folder / "stamps.csv").write_text("\n".join(rows) + "\n")
    return '[data]\nfiles = "stamps.csv"\nbase = "base"\nsensors = ["floor 1", "floor 2", "roof"]\n'


def table_in_mg(folder):
    rows = [f"{5 * k},{1e3 * a / G:.6f}" for k, a in enumerate(BASE)]
    (folder / "base.csv").write_text("\n".join(["time_ms,a_x_mg", *rows]) + "\n")


def commas(folder):
    """Decimal commas in Latin-1 at 156.25 Hz beside points at 200 Hz."""
    table_in_mg(folder)
    roof = signal.resample_poly(FLOORS[2], 25, 32)
    rows = [f"{0.0064 * k:.6f};{1e3 * a:.6f}".replace(".", ",") for k, a in enumerate(roof)]
    text = "\n".join(["Zeit [s];Dach [mm/s²]", *rows]) + "\n"
    (folder / "roof.txt").write_bytes(text.encode("latin-1"))
    return (
        '[data]\nbase = "base"\nsensors = ["roof"]\ndofs = [2]\nresample = 200.0\n'
        '[data.files]\nbase = "base.csv"\nroof = "roof.txt"\n'
    )


def axes(folder):
    """Three axes over the numbers of samples, without a unit."""
    table_in_mg(folder)
    noise = 0.01 * RNG.normal(size=(2, N))
    rows = [f"{k},{FLOORS[2, k]:.8f},{noise[0, k]:.6f},{G + noise[1, k]:.6f}" for k in range(N)]
    (folder / "axes.csv").write_text("\n".join(["Sample,X,Y,Z", *rows]) + "\n")
    return (
        '[data]\nbase = "base"\nsensors = ["roof"]\ndofs = [2]\n[data.files]\nbase = "base.csv"\n'
        'roof = {file = "axes.csv", column = "X", units = "m/s^2", dt = 0.005, clock = "Sample"}\n'
    )


def by_sensor(folder):
    """A voltage at the base, inverted, and laser displacements in mm."""
    for name, sign, header, columns in (
        ("volts.csv", ";", "time [s];table [V]", [-0.1 * BASE / G]),
        ("laser.csv", ",", "time [s],laser top [mm],laser mid [mm]", 1e3 * DRIFT[[2, 1]]),
    ):
        np.savetxt(folder / name, np.column_stack([TIME, *columns]), "%.9f", sign, header=header, comments="")
    return (
        '[data]\nbase = "table"\nsensors = ["mid", "top"]\ndofs = [1, 2]\n'
        'quantity = "relative_displacement"\n'
        '[data.files]\ntable = {file = "volts.csv", sensitivity = "100 mV/g", scale = -1.0}\n'
        'mid = {file = "laser.csv", column = "laser mid"}\ntop = {file = "laser.csv", column = "laser top"}\n'
    )


LOGGERS = {
    "stamps": (stamps, FLOORS, 1e-6),
    "commas": (commas, FLOORS[2:], 2e-3),
    "axes": (axes, FLOORS[2:], 1e-6),
    "by sensor": (by_sensor, DRIFT[1:], 1e-6),
}


@pytest.mark.parametrize("logger", LOGGERS)
def test_loggers(tmp_path, logger):
    write, expected, tolerance = LOGGERS[logger]
    text = write(tmp_path) + TAIL.replace("SIGMA", "0.001" if logger == "by sensor" else "0.1")
    assert len(text.splitlines()) <= 30
    (tmp_path / "update.toml").write_text(text)
    problem = read_problem(tmp_path / "update.toml")
    measured = problem.measured
    n = min(measured.channels.sizes["time"], N) - 20
    inner = slice(20, n)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(
        measured.channels.values[:, inner], expected[:, inner], atol=tolerance * scale + 1e-7
    )
    np.testing.assert_allclose(measured.record.acceleration[inner], BASE[inner], atol=1e-5)
    assert measured.units == ("m" if logger == "by sensor" else "m/s^2")
    files = measured.source.split(", ")
    assert len(files) == len(set(files))
    model = declare(problem, "EXP")
    logp = model.compile_logp()
    wrong, right = (logp({"k1_log__": np.log(k)}) for k in (2.4e6, 1.8e6))
    assert right > wrong + 1.0


def test_displacements_under_a_record(tmp_path):
    """The motion of the base from a file of its own: all sensors measure displacements."""
    text = "\n".join(line for line in by_sensor(tmp_path).splitlines() if "table" not in line) + "\n"
    np.savetxt(tmp_path / "base.txt", np.column_stack([TIME, BASE]), fmt="%.9f")
    text += '[record]\npath = "base.txt"\nunits = "m/s^2"\n' + TAIL.replace("SIGMA", "0.001")
    (tmp_path / "update.toml").write_text(text)
    measured = read_problem(tmp_path / "update.toml").measured
    assert measured.units == "m"
    np.testing.assert_allclose(measured.channels.values, DRIFT[1:], atol=1e-7)
    np.testing.assert_allclose(measured.record.acceleration, BASE, atol=1e-8)


def test_the_check_says_mass_and_frequencies(tmp_path, capsys):
    """And displacements need a table of files."""
    path, text = tmp_path / "update.toml", stamps(tmp_path) + TAIL.replace("SIGMA", "0.1")
    path.write_text(text)
    assert main(["check", str(path)]) == 0
    said = capsys.readouterr().err.replace("\n", " ")
    assert "3 degrees of freedom, 3000 kg that the base moves" in said and "frequencies" in said
    path.write_text(text.replace("[data]\n", '[data]\nquantity = "relative_displacement"\n'))
    with pytest.raises(ValueError, match="must have `files` as a table of sensors for `quantity`"):
        read_problem(path)


def test_matrices_in_other_units(tmp_path):
    """kN, m and t give the structure of N, m and kg."""
    tail = """
[structure]
type = "AffineStructure"
units = "kN, m, t"
mass = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
stiffness = [[1600.0, -1600.0, 0.0], [-1600.0, 3000.0, -1400.0], [0.0, -1400.0, 1400.0]]
stiffness_terms = [[[1800.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]
theta = ["t1"]
damping = {type = "ModalDamping", ratios = 0.03}
[priors]
t1 = {distribution = "LogNormal", mu = 0.0, sigma = 0.3}
[likelihood]
kinds = ["EXP"]
sigma = 0.1
"""
    (tmp_path / "update.toml").write_text(stamps(tmp_path) + tail)
    structure = read_problem(tmp_path / "update.toml").structure(t1=1.0)
    np.testing.assert_allclose(
        structure.modes().natural_frequencies, CHAIN.modes().natural_frequencies, rtol=1e-9
    )


def test_convert(tmp_path, capsys):
    stamps(tmp_path)
    source, target = tmp_path / "stamps.csv", tmp_path / "si.csv"
    assert main(["convert", str(source), str(target)]) == 0
    np.testing.assert_allclose(pmf.read_channels(target).values, pmf.read_channels(source).values)
    assert main(["convert", str(source), str(target)]) == 2
    assert "si.csv is there. Pass --force" in capsys.readouterr().err.replace("\n", " ")
    modes = tmp_path / "modes.json"
    pmf.modal.write_modal(pmf.modal.ModalData([1.0, 2.5], [[1.0], [0.5]], ["roof"]), modes)
    assert main(["convert", str(modes), str(tmp_path / "modes.csv")]) == 0
    assert pmf.read_modal(tmp_path / "modes.csv").channels == ("roof",)
