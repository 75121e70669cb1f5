"""Specimens under a prescribed displacement: a tight ODE solution, closed forms, energy, and refusals."""

import numpy as np
import pytensor.tensor as pt
import pytest

from benchmarks.truth import cycles, specimen_force
from pymc_features import LinearStructure, ModalDamping, modes, response, simulate
from pymc_features.simulators.cyclic import NAMES, forces
from pymc_features.simulators.oscillators.arguments import Excitation
from pymc_features.structures import CyclicTest, Degradation, HystereticSpecimen, Pinching, integration_error
from support.reference import richardson
from support.refusals import refusals
from support.straight import Record


def random_law(seed):
    """Strong pinching and degradation; n is 1, 2 or another."""
    rng = np.random.default_rng(seed)
    beta, n = rng.uniform(0.3, 1.0), (1.0, 2.0, rng.uniform(1.1, 4.0))[seed % 3]
    shape = n, beta, beta * rng.uniform(-0.5, 1.0), rng.uniform(0.0, 0.05), rng.uniform(0.0, 0.1)
    pinch = rng.uniform(0.5, 0.98), rng.uniform(0.2, 3.0), rng.uniform(0.0, 0.3), rng.uniform(0.1, 0.4)
    ends = rng.uniform(0.0, 0.02), rng.uniform(0.05, 0.5)
    return np.array(
        [rng.uniform(1e6, 1e8), rng.uniform(2e-3, 1e-2), rng.uniform(0, 0.3), *shape, *pinch, *ends]
    )


def force_of(law, displacement):
    return forces(law, Excitation(displacement, 1.0, 1, 1))[0]


@pytest.mark.parametrize("seed", range(3))
def test_force_is_that_of_a_tight_ode_solution(seed):
    law = random_law(seed)
    displacement = cycles(law[1], [1.0, -1.0, 3.0, -3.0, 4.0, -5.0, 6.0], 5)
    expected = specimen_force(law, displacement)
    np.testing.assert_allclose(force_of(law, displacement), expected, rtol=0, atol=1e-7 * abs(expected).max())
    # in a single step from peak to peak too, and on the way between given displacements
    excitation = Excitation(displacement[::5], 1.0, 5, 1)
    np.testing.assert_allclose(forces(law, excitation)[0], expected, rtol=0, atol=1e-7 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_derivatives_are_those_of_the_ode_solution(seed):
    law = random_law(seed)
    if seed == 0:
        law[3] = 1.05  # no difference can be taken at n = 1
    displacement = cycles(law[1], [2.0, -2.0], 1)
    _, derivatives = forces(law, Excitation(displacement, 1.0, 1, 1), with_gradient=True)
    for i, name in enumerate(NAMES):
        step = law * (np.arange(law.size) == i)  # relative to the parameter
        expected = richardson(lambda x: specimen_force(x, displacement), law, step, h=8e-3)
        np.testing.assert_allclose(
            law[i] * derivatives[i],
            expected,
            rtol=0,
            atol=1e-6 * abs(force_of(law, displacement)).max(),
            err_msg=name,
        )


def exponential(w, x, c):
    """n = 1: dw/dx = 1 - c w."""
    return (1.0 - (1.0 - c * w) * np.exp(-c * x)) / c


def closed_form(w, x, n, beta, gamma):
    """w after the way x without degradation and pinching."""
    c, root = beta - gamma, np.sqrt(beta - gamma)
    if w < 0.0:
        to_zero = np.log1p(-c * w) / c if n == 1.0 else np.arctan(-root * w) / root
        if x <= to_zero:
            return exponential(w, x, c) if n == 1.0 else np.tan(root * x + np.arctan(root * w)) / root
        w, x = 0.0, x - to_zero
    c, root = beta + gamma, np.sqrt(beta + gamma)
    return exponential(w, x, c) if n == 1.0 else np.tanh(root * x + np.arctanh(root * w)) / root


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_without_degradation_and_pinching_the_closed_form(n):
    k, reach, ratio, beta, gamma = 2e6, 0.01, 0.1, 0.7, 0.2
    specimen = HystereticSpecimen(
        k, yield_displacement=reach, post_yield_ratio=ratio, sharpness=n, beta=beta, gamma=gamma
    )
    displacement = cycles(reach, [0.5, -0.2, 2.0, 1.5, -3.0, 4.0, 4.0], 7)
    w, way, expected = 0.0, 1.0, [0.0]
    for change in np.diff(displacement):
        w = w if change * way >= 0.0 else -w
        way = np.sign(change) or way
        w = closed_form(w, abs(change) / reach, n, beta, gamma)
        expected.append((1.0 - ratio) * k * reach * way * w)
    expected = np.array(expected) + ratio * k * displacement
    found = simulate(specimen, CyclicTest(displacement))
    np.testing.assert_allclose(found.values[0], expected, rtol=0, atol=1e-8 * abs(expected).max())
    np.testing.assert_array_equal(found["displacement"], displacement)


def least_dissipation(law):
    """Least change of e - eta z^2 / 2 over any small part of some cycles, beside the largest."""
    displacement = cycles(law[1], [1.0, -1.0, 2.0, -2.0, 3.0, -3.0], 400)
    k, reach, ratio = law[:3]
    z = (force_of(law, displacement) - ratio * k * displacement) / ((1.0 - ratio) * k * reach)
    e = np.append(0.0, np.cumsum(0.5 * (z[1:] + z[:-1]) * np.diff(displacement) / reach))
    lost = np.diff(e - 0.5 * (1.0 + law[7] * e) * z**2)
    return lost.min() / lost.max()


@pytest.mark.parametrize(("gamma", "d_eta", "n"), [(0.5, 0.0, 2.0), (-0.3, 0.0, 3.0), (0.2, 1.9, 2.0)])
def test_dissipation_where_theory_says_so(gamma, d_eta, n):
    """Erlicher and Point's condition, and that of `structures.HystereticSpecimen` for a loss of stiffness."""
    law = np.array([1e6, 0.01, 0.05, n, 1.0 - gamma, gamma, 0.03, d_eta, *[0.0] * 3, 1.0, 0.0, 1.0])
    assert least_dissipation(law) > -1e-4  # of the trapezoidal rule
    law[7] = 8.0
    assert least_dissipation(law) < -1e-2


def specimen(**changes):
    return HystereticSpecimen(
        **{"stiffness": 1e6, "yield_displacement": 0.01, "post_yield_ratio": 0.1} | changes
    )


def test_what_is_no_specimen_gives_nan():
    k, gamma = pt.scalar("k"), pt.scalar("gamma")
    test = CyclicTest([0.0, 0.01, -0.01])
    force = response(specimen(stiffness=k, gamma=gamma), test)
    for values in ((-1.0, 0.5), (1.0, 0.6), (1.0, -0.5), (1.0, np.nan)):
        assert np.isnan(force.eval(dict(zip((k, gamma), values, strict=True)))).all()
    assert np.isfinite(force.eval({k: 1.0, gamma: -0.4})).all()


TEST = CyclicTest([0.0, 0.01])
CHAIN = LinearStructure([1.0], stiffness=[1.0], damping=ModalDamping(0.0))


VALUES = {
    "`quantity` must be one of restoring_force, got 'base_shear'": lambda: simulate(
        specimen(), TEST, quantity="base_shear"
    ),
    "`quantity` must be one of absolute_acceleration": lambda: simulate(
        CHAIN, Record([0.0, 1.0], 0.1), quantity="restoring_force"
    ),
    "`gamma` must lie above -beta and not exceed beta = 0.5, got 0.6": lambda: specimen(gamma=0.6),
    "`gamma` must be finite, got nan": lambda: specimen(gamma=np.nan),
    "`slip` must be below 1, got 1. With 1 a spring would slip": lambda: Pinching(1.0),
    "`strength` must be a scalar, got 1 dimension": lambda: Degradation([0.1, 0.2]),
    "`displacement` must be one-dimensional with at least 2 samples": lambda: CyclicTest([[0.0, 0.1]]),
}
TYPES = {
    "`record` must be a CyclicTest for a HystereticSpecimen, got Record. A specimen has no mass": lambda: (
        simulate(specimen(), Record([0.0, 1.0], 0.1))
    ),
    "`record` must be a Record for a LinearStructure, got CyclicTest. Only a HystereticSpecimen": lambda: (
        simulate(CHAIN, TEST)
    ),
    "`structure` must have masses for this, got a HystereticSpecimen": lambda: modes(specimen(), 1),
    "`structure` must be a nonlinear chain, got HystereticSpecimen": lambda: integration_error(
        specimen(), TEST
    ),
    "`pinching` must be a Pinching, got float. Leave it out for none": lambda: specimen(pinching=0.5),
}


@refusals("call", VALUES, TYPES)
def test_refusals(call, error, match):
    with pytest.raises(error, match=match):
        call()
