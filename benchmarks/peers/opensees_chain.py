"""OpenSees (optional): a chain, by Newmark's method, ten steps for each sample; Newton's for yielding."""

import numpy as np

from benchmarks.peers.population import mean_squares

PARTS = 10  # steps for each sample: with one, its accelerations are far off


def prepare(population):
    """Return a call that evaluates e_j of chains, one after the other. ImportError without OpenSeesPy."""
    import openseespy.opensees as ops

    case, family = population.case, population.structure.family
    mass, springs, ((alpha, beta),) = population.parameters[:3]

    def build(stiffness, values):
        ops.wipe()
        ops.model("basic", "-ndm", 1, "-ndf", 1)
        ops.node(0, 0.0)
        ops.fix(0, 1)
        for i, k in enumerate(stiffness.tolist(), start=1):
            ops.node(i, 0.0, "-mass", float(mass[0, i - 1]))
            if family == "hysteretic":
                d_y, a, n, b, g = values[:, i - 1].tolist()  # its z is a drift
                ops.uniaxialMaterial("BoucWen", i, a, k, n, g / d_y**n, b / d_y**n, 1.0, 0.0, 0.0, 0.0)
            else:
                ops.uniaxialMaterial("Elastic", i, k)
            ops.element("zeroLength", i, i - 1, i, "-mat", i, "-dir", 1, "-doRayleigh", 1)
        ops.rayleigh(float(alpha), 0.0, float(beta), 0.0)
        ops.timeSeries("Path", 1, "-dt", case.step, "-values", *case.fine_acceleration.tolist(), "-useLast")
        ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
        ops.constraints("Plain")
        ops.numberer("Plain")
        ops.system("BandGeneral")
        ops.test("NormDispIncr", 1e-10, 50)
        ops.algorithm("Newton") if family == "hysteretic" else ops.algorithm("Linear", "-factorOnce")
        ops.integrator("Newmark", 0.5, 0.25)
        ops.analysis("Transient")

    def history(stiffness, values):
        build(stiffness, values)
        found = np.zeros((case.sensors.size, case.observed.shape[1]))
        for step in range(1, found.shape[1]):
            if ops.analyze(PARTS, case.step / PARTS):
                raise RuntimeError("OpenSees found no equilibrium")
            found[:, step] = [ops.nodeAccel(int(i) + 1, 1) for i in case.sensors]
        return found + case.fine_acceleration

    def evaluate():
        values = population.parameters[4] if family == "hysteretic" else [None]
        own = [history(k, values[p % len(values)]) for p, k in enumerate(springs)]
        return mean_squares(own, case)

    return evaluate
