"""One likelihood of a frame in OpenSees, by running it and by its matrices, which are read once.

A building on four columns, its floors rigid in their planes, rotations without mass: ms for one likelihood of
three parameters and three sensors. OpenSees gets Newmark's method with one factorisation, at the step of the
record, and at a tenth of it, where its accelerations begin to be accurate. Needs the group `opensees`.
"""

from importlib.util import find_spec

import numpy as np
import pymc as pm

import pymc_features as pmf
from benchmarks.case import record_of_length
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds

STOREYS = (3, 10, 30)
CORNERS = ((0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0))
NOMINAL = {"columns": 30e9, "beams": 28e9, "mass": 20e3}
DAMPING = pmf.RayleighDamping(0.3, 0.001)
N_MODES = 9


def builder(storeys):
    """A function that makes the building: E of the columns and beams, and the mass of a floor."""
    import openseespy.opensees as ops

    def build(columns, beams, mass):
        ops.wipe()
        ops.model("basic", "-ndm", 3, "-ndf", 6)
        ops.geomTransf("Linear", 1, 1.0, 0.0, 0.0)
        ops.geomTransf("Linear", 2, 0.0, 0.0, 1.0)
        for s in range(storeys + 1):
            corners = [10 * s + i for i in range(4)]
            for node, place in zip(corners, CORNERS, strict=True):
                ops.node(node, *place, 3.0 * s)
                if s == 0:
                    ops.fix(node, 1, 1, 1, 1, 1, 1)
            if s == 0:
                continue
            for i, node in enumerate(corners):
                for tag, other, modulus, axes in (
                    (100 * s + i, node - 10, columns, 1),
                    (100 * s + 10 + i, corners[(i + 1) % 4], beams, 2),
                ):
                    section = 0.16, modulus, modulus / 2.4, 4e-3, 2e-3, 2e-3
                    ops.element("elasticBeamColumn", tag, other, node, *section, axes)
            master = 10 * s + 9
            ops.node(master, 2.5, 2.3, 3.0 * s)
            ops.fix(master, 0, 0, 1, 1, 1, 0)
            ops.rigidDiaphragm(3, master, *corners)
            ops.mass(master, mass, mass, 0.0, 0.0, 0.0, 5.0 * mass)
        ops.rayleigh(DAMPING.alpha, 0.0, DAMPING.beta, 0.0)

    return build


def integrated(build, record, parts):
    """Absolute accelerations (3, time) of the top by OpenSees."""
    import openseespy.opensees as ops

    build(**NOMINAL)
    ops.timeSeries("Path", 1, "-dt", record.dt, "-values", *record.acceleration.tolist(), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("BandGeneral")
    ops.algorithm("Linear", "-factorOnce")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    top, found = max(ops.getNodeTags()), np.zeros((3, record.n_times))
    for step in range(1, record.n_times):
        if ops.analyze(parts, record.dt / parts):
            raise RuntimeError("OpenSees found no equilibrium")
        found[:, step] = [ops.nodeAccel(*place) for place in ((top, 1), (top - 9, 1), (top, 2))]
    ground = np.array([1.0, 1.0, 0.0])[:, None] * record.acceleration
    return found + ground


def likelihood(structure, record, sensors, measured):
    """The log-likelihood of a model, compiled, at the nominal parameters."""
    nominal = np.array(list(NOMINAL.values()))
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5, shape=3)
        mu = pmf.response(
            structure.with_parameters(theta * nominal), record, sensors=sensors, n_modes=N_MODES
        )
        pmf.TruncNormalFeature("y", mu=mu, sigma=0.1, observed=measured)
    function, point = model.compile_logp(), model.initial_point()
    return lambda: function(point)


def run(quick=False):
    """Print the table."""
    print("\n## One likelihood of a frame in OpenSees: ms, 1559 samples, 3 sensors\n")
    if find_spec("openseespy") is None:
        print("OpenSeesPy is not installed: python -m uv run --group opensees --group benchmarks ...")
        return
    rows, record = [], record_of_length(1559)
    for storeys in STOREYS[: 1 if quick else None]:
        build = builder(storeys)
        structure = pmf.AffineStructure.from_opensees(build, NOMINAL, damping=DAMPING)
        top = 10 * storeys + 9
        sensors = [f"{top}:x", f"{top - 9}:x", f"{top}:y"]
        exact = pmf.simulate(structure, record, sensors=sensors).values
        errors = []
        for parts in (1, 10):
            found = integrated(build, record, parts)
            errors.append(abs(found - exact).max() / abs(exact).max())
        best = best_of_rounds(
            {
                "run": lambda: integrated(build, record, 1),  # noqa: B023  called in this turn
                "matrices": likelihood(structure, record, sensors, exact),
            },
            1 if quick else 3,
        )
        ratio = best["run"] / best["matrices"]
        rows.append(
            [
                f"{storeys} storeys, {structure.n_dof} DOF",
                significant(1e3 * best["run"]),
                *(f"{100.0 * error:.2g}" for error in errors),
                significant(1e3 * best["matrices"]),
                significant(ratio),
            ]
        )
    headers = ["frame", "OpenSees, 1 step", "its error: %", "at 10 steps: %", "by matrices", "ratio"]
    print(table(headers, rows), flush=True)
