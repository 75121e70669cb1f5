"""A frame in OpenSees, and OpenSees itself or, where it is not installed, what it answered once.

`python -m support.opensees`, in the folder of the tests and with the group `opensees`, asks it anew.
"""

import gzip
import hashlib
import json
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from support.straight import Record

STORED = Path(__file__).with_name("opensees_answers.json.gz")
ANSWERS = {"printA", "printB", "systemSize", "getNodeTags", "nodeDOFs", "nodeCoord", "getNDF"} | {
    *("getConstrainedNodes", "getConstrainedDOFs", "eigen", "analyze"),
}
STATE = {"integrator", "load"}  # the last call of each decides what is answered
ANALYSIS = {"constraints", "numberer", "system", "algorithm", "analysis", "wipeAnalysis", "timeSeries"} | {
    *("pattern", "remove", "test"),
}
OPENSEES = import_module("openseespy.opensees") if find_spec("openseespy") else None
STOREYS, BAYS = 3, ((0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0))
NOMINAL = {"columns": 30e9, "beams": 28e9, "mass": 20e3}  # E of the ground storey, E above, of a floor [kg]
CHANGED = {"columns": 21e9, "beams": 31e9, "mass": 17e3}
ALPHA, BETA = 0.3, 0.001
DT, FINE = 0.02, 120  # step of the record, and its parts in the integration


class Stored:
    """The commands of OpenSees as attributes, answered from a file, or by it and then stored."""

    def __init__(self, answers: dict, ops=None):
        self._answers, self._ops, self._model, self._state = answers, ops, "", {}

    def __getattr__(self, name):
        def command(*given):
            if name == "wipe":
                self._model, self._state = "", {}
            elif name in STATE:
                self._state[name] = given
            elif name not in ANSWERS and name not in ANALYSIS:
                self._model += repr((name, given))
            key = repr((self._model, sorted(self._state.items()), name, given))
            key = hashlib.sha256(key.encode()).hexdigest()[:24]
            if self._ops is not None:
                answer = getattr(self._ops, name)(*given)
                if name in ANSWERS:
                    self._answers[key] = answer
            elif name in ANSWERS and key not in self._answers:
                raise LookupError(f"{name}{given} of this model is not among the answers: store them anew")
            return self._answers.get(key)

        return command


def install(monkeypatch) -> None:
    """Make `openseespy` importable where it is not installed."""
    if OPENSEES is None:
        put(Stored(json.loads(gzip.decompress(STORED.read_bytes()))), monkeypatch.setitem)


def put(commands, setitem) -> None:
    """Put commands in the place of the module."""
    package = ModuleType("openseespy")
    package.opensees = commands
    setitem(sys.modules, "openseespy", package)
    setitem(sys.modules, "openseespy.opensees", commands)


def building(columns, beams, mass, *, height=3.0, damped=False, loose=False):
    """Floors on four columns, rigid in their planes, whose masses lie off the middle; one storey is soft.

    Nodes 10 s + 1 ... 10 s + 4 of floor s follow its master 10 s + 9, the only one with mass.
    """
    import openseespy.opensees as ops

    area, inertia = 0.16, 0.4**4 / 12
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    ops.geomTransf("Linear", 1, 1.0, 0.0, 0.0)
    ops.geomTransf("Linear", 2, 0.0, 0.0, 1.0)
    for s in range(STOREYS + 1):
        for i, (x, y) in enumerate(BAYS, start=1):
            ops.node(10 * s + i, x, y, height * s)
            if s == 0:
                ops.fix(i, 1, 1, 1, 1, 1, 1)
    for s in range(1, STOREYS + 1):
        modulus = columns if s == 1 else beams
        section = area, modulus, modulus / 2.4, 2.0 * inertia, inertia, inertia
        for i in (1, 2, 3, 4):
            ops.element("elasticBeamColumn", 100 * s + i, 10 * s - 10 + i, 10 * s + i, *section, 1)
        section = area, beams, beams / 2.4, 2.0 * inertia, inertia, inertia
        for i in (1, 2, 3, 4):
            ops.element("elasticBeamColumn", 100 * s + 10 + i, 10 * s + i, 10 * s + i % 4 + 1, *section, 2)
        master = 10 * s + 9
        ops.node(master, 2.5, 2.3, height * s)
        if not loose:
            ops.fix(master, 0, 0, 1, 1, 1, 0)
        ops.rigidDiaphragm(3, master, *(10 * s + i for i in (1, 2, 3, 4)))
        ops.mass(master, mass, mass, 0.0, 0.0, 0.0, 5.0 * mass)
    if damped:
        ops.rayleigh(ALPHA, 0.0, BETA, 0.0)


def tied_frame(stiffness, mass):
    """A plane frame with a tie, an inclined guide and a hinge at its foot."""
    import openseespy.opensees as ops

    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for node, (x, y) in enumerate([(0.0, 0.0), (5.0, 0.0), (0.0, 4.0), (5.0, 4.0)], start=1):
        ops.node(node, x, y)
    ops.fix(1, 1, 1, 1)
    ops.fix(2, 1, 1, 0)
    ops.geomTransf("Linear", 1)
    for tag, (i, j) in enumerate([(1, 3), (2, 4), (3, 4)], start=1):
        ops.element("elasticBeamColumn", tag, i, j, 0.1, 1e9, stiffness / 1e9, 1)
    ops.equalDOF(3, 4, 1)
    ops.mass(3, mass, mass, 0.0)
    ops.mass(4, mass, mass, 0.0)


def angular_frequencies(ops, n: int) -> np.ndarray:
    """Of the model that is there, by OpenSees [rad/s]."""
    ops.constraints("Transformation")
    return np.sqrt(ops.eigen("-fullGenLapack", n))


def shaking() -> Record:
    """Noise, 4 s long, that begins from zero."""
    rng = np.random.default_rng(8)
    n = 201
    return Record(np.r_[0.0, rng.normal(size=n - 1)] * np.minimum(1.0, np.arange(n) / 20), DT, name="noise")


WATCHED = [(39, 1), (31, 1), (31, 2), (13, 2), (29, 6), (33, 3), (33, 4)]  # nodes and directions


def integrated(ops, record: Record, parts: int = FINE) -> np.ndarray:
    """Relative accelerations at `WATCHED` (row, time), ground in x, by Newmark's average acceleration."""
    ops.timeSeries("Path", 1, "-dt", record.dt, "-values", *record.acceleration.tolist(), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("BandGeneral")
    ops.algorithm("Linear", "-factorOnce")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    found = np.zeros((len(WATCHED), record.n_times))
    for step in range(1, record.n_times):
        if ops.analyze(parts, record.dt / parts):
            raise RuntimeError("no step")
        found[:, step] = [ops.nodeAccel(*place) for place in WATCHED]
    return found


def answered(name: str, question) -> np.ndarray:
    """What a question to OpenSees gives, or gave."""
    if OPENSEES is not None:
        OPENSEES.wipe()
        found = question(OPENSEES)
        OPENSEES.wipe()
        return found
    return np.array(json.loads(gzip.decompress(STORED.read_bytes()))[name])


def frequencies_of_the_building(ops):
    """Of the changed building."""
    building(**CHANGED)
    return angular_frequencies(ops, 3 * STOREYS)


def history_of_the_building(ops):
    """Of the changed building, damped."""
    building(**CHANGED, damped=True)
    return integrated(ops, shaking())


def frequencies_of_the_frame(ops):
    """Of the plane frame."""
    tied_frame(3e7, 800.0)
    return angular_frequencies(ops, 3)


QUESTIONS = {
    "frequencies": frequencies_of_the_building,
    "history": history_of_the_building,
    "frequencies of the frame": frequencies_of_the_frame,
}


class Storing:
    """Stands between the tests and OpenSees."""

    def __init__(self):
        self.answers = {}

    def pytest_sessionstart(self):
        for name, question in QUESTIONS.items():
            self.answers[name] = answered(name, question).tolist()
        put(Stored(self.answers, OPENSEES), lambda modules, name, value: modules.update({name: value}))


def store() -> None:
    """Ask OpenSees what the tests ask, and write its answers."""
    import pytest

    tests, storing = Path(__file__).parents[1] / "structures" / "test_opensees.py", Storing()
    if pytest.main(["-q", "-p", "no:xdist", "-o", "addopts=", str(tests)], plugins=[storing]) == 0:
        text = json.dumps(storing.answers, sort_keys=True).encode()
        STORED.write_bytes(gzip.compress(text, mtime=0))


if __name__ == "__main__":
    from support import opensees  # the module that the tests import

    opensees.store()
