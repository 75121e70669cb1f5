"""Fused sums, gradients and tangents of nonlinear chains: loops, differences, SciPy, the linear limit."""

import numpy as np
import pytensor.tensor as pt
import pytest

from pymc_features.ops.comparison import misfit_cotangent
from pymc_features.simulators import Excitation
from pymc_features.simulators.families import FAMILIES, NONLINEAR
from pymc_features.simulators.nonlinear.kernels import nonlinear_histories
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.graphs import PLAIN
from support.kernels import flat_kernels
from support.yielding import tight_solution

pytestmark = pytest.mark.slow  # each family has kernels of its own

KERNELS = {family: flat_kernels(family) for family in NONLINEAR}
NAMES = ("mass", "stiffness", "rayleigh", "ratios", "values")
DT = 0.02


def parameters(family, n=3, *, modal=False, sharpness=2.0, seed=0):
    """Springs that yield, or harden several times, under the records below; every spring is different."""
    rng = np.random.default_rng(seed)
    mass, stiffness = rng.uniform(0.8, 1.2, n), rng.uniform(300.0, 400.0, n)
    rayleigh, ratios = np.array([0.2, 1e-3]), np.zeros(n)
    if modal:
        rayleigh, ratios = np.zeros(2), np.linspace(0.02, 0.05, n)
    values = np.full((1, n), 1e6)
    if family == "hysteretic":
        values = np.tile(np.array([0.008, 0.1, sharpness, 0.5, 0.4])[:, None], n)
    values = values * rng.uniform(0.95, 1.05, values.shape)
    if sharpness in (1.0, 2.0) and family == "hysteretic":
        values[2] = sharpness
    return mass, stiffness, rayleigh, ratios, values


def settings(n=3, *, n_times=60, substeps=1, stride=1, quantity=0, sensors=(2, 0), dt=DT, seed=1):
    """Arguments behind the parameters."""
    acceleration = 3.0 * np.random.default_rng(seed).normal(size=n_times)
    return acceleration, dt, substeps, stride, np.array(sensors) % n, n, quantity


def directions(given, seed=2):
    """Random changes of a few tenths of each parameter; of a zero, of a tenth; no modal damping stays."""
    rng = np.random.default_rng(seed)
    changes = [0.3 * rng.normal(size=p.shape) * np.where(p == 0.0, 0.3, np.abs(p)) for p in given]
    changes[3] *= given[3].any()
    return tuple(changes)


def moved(given, change, h):
    return tuple(p + h * d for p, d in zip(given, change, strict=True))


def differences(function, given, change, h):
    """Central difference along a direction, extrapolated once."""
    coarse, fine = (
        (function(moved(given, change, s)) - function(moved(given, change, -s))) / (2.0 * s)
        for s in (h, 0.5 * h)
    )
    return (4.0 * fine - coarse) / 3.0


def inner(gradient, change):
    return sum((g[d != 0.0] * d[d != 0.0]).sum() for g, d in zip(gradient, change, strict=True))


def data(family, given, where, seed=3):
    """A response, and data far from it."""
    response = KERNELS[family]["response"](*given, *where)
    return response, response + np.abs(response).max() * np.random.default_rng(seed).normal(
        size=response.shape
    )


CASES = {
    "bouc-wen": ("hysteretic", {}, {}),
    "bouc-wen, modal, n = 3.3, coarse velocity": (
        "hysteretic",
        {"modal": True, "sharpness": 3.3},
        {"stride": 3, "quantity": 2},
    ),
    "bouc-wen, ten masses, one sensor twice": (
        "hysteretic",
        {"n": 10, "modal": True},
        {"n": 10, "n_times": 40, "quantity": 1, "sensors": (9, 3, 9)},
    ),
    "duffing": ("duffing", {}, {}),
    "duffing, one mass, modal, fine": ("duffing", {"n": 1, "modal": True}, {"n": 1, "substeps": 2}),
}


def of_case(name):
    """Family, parameters and what follows them, a response and data."""
    family, structure, where = CASES[name]
    given, where = parameters(family, **structure), settings(**where)
    return family, given, where, *data(family, given, where)


@pytest.mark.parametrize("name", CASES)
def test_misfit_gradient(name):
    """The Taylor steps in reverse, against differences of the response by Runge-Kutta steps.

    1e-4 of the largest derivative by the logarithm of a parameter.
    """
    family, given, where, response, observed = of_case(name)
    weights = np.random.default_rng(7).normal(size=(len(response), 4))
    for n_statistics in (1, 4):
        cotangent = np.pad(weights[:, :n_statistics], [(0, 0), (0, 4 - n_statistics)])
        symbolic = misfit_cotangent(pt.as_tensor(observed - response), pt.as_tensor(cotangent))
        theirs = KERNELS[family]["response_gradient"](*given, *where, -symbolic.eval(mode=PLAIN))
        ours = KERNELS[family]["misfit_gradient"](*given, *where, observed, weights[:, :n_statistics])
        a, b = (
            np.concatenate([(g * p).ravel() for g, p in zip(gradient, given, strict=True)])
            for gradient in (ours, theirs)
        )
        n = len(given[0])
        assert np.isnan(a).sum() in (0, n, 2 * n)  # ratios that do not damp, and a sharpness of 2
        assert np.nanmax(np.abs(a - b)) < 1e-4 * np.nanmax(np.abs(b))


@pytest.mark.parametrize(("sharpness", "names"), [(2.0, ("law[2]",)), (8.0, ("stiffness", "law[0]"))])
def test_what_is_sought(sharpness, names):
    """A sharpness that happens to be 2, and springs sharper than Taylor steps serve, by differences."""
    given, where = parameters("hysteretic", sharpness=sharpness), settings()
    response, observed = data("hysteretic", given, where)
    arguments = FAMILIES["hysteretic"].assemble([*given, *where[:4], NO_DIRECT, *where[4:6]], where[6])
    kernels = FAMILIES["hysteretic"].kernels
    found = kernels["misfit_gradient"](*arguments, observed, np.ones((2, 1)), sought=names)
    cotangent = 2.0 * (response - observed) / observed.shape[1]
    exact = kernels["response_gradient"](*arguments, cotangent, sought=names)
    for p, name in enumerate(NAMES[:4]):
        assert np.isfinite(exact[p]).all() == np.isfinite(exact[p]).any() == (name in names)
    for row in range(5):
        assert np.isfinite(exact.law[row]).all() == (f"law[{row}]" in names)
    for a, b in zip(found, exact, strict=True):
        wanted = np.isfinite(b)
        assert (np.abs(a - b)[wanted] < 1e-4 * np.abs(b[wanted]).max(initial=0.0)).all()


@pytest.mark.parametrize("name", CASES)
def test_tangents_are_transposes(name):
    """<W, T d> = <G W, d> to 2e-6; the derivative of e_j is that of the response times twice the misfit."""
    family, given, where, response, observed = of_case(name)
    change, weights = directions(given, 1), np.random.default_rng(8).normal(size=response.shape)
    tangent = KERNELS[family]["response_tangent"](*given, *where, *change)
    gradient = KERNELS[family]["response_gradient"](*given, *where, weights)
    scale = np.abs(weights * tangent).sum()
    assert abs((weights * tangent).sum() - inner(gradient, change)) < 2e-6 * scale
    sums = KERNELS[family]["discrepancy_tangent"](*given, *where, observed, *change)
    expected = (2.0 * (response - observed) * tangent).mean(1)
    np.testing.assert_allclose(sums, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


LAW_AT_A_BOUND = {
    "n = 1": (2, 1.0),
    "ratio 0": (1, 0.0),
    "ratio 1": (1, 1.0),
    "gamma 0": (4, 0.0),
    "gamma = beta": (4, 0.5),
}


@pytest.mark.parametrize("case", [*LAW_AT_A_BOUND, "cubic 0"])
def test_tangents_at_the_bounds_of_a_law(case):
    """One-sided differences, where only one side is a structure; and a size for what is zero."""
    family = "duffing" if case == "cubic 0" else "hysteretic"
    row, value = LAW_AT_A_BOUND.get(case, (0, 0.0))
    given, where = parameters(family), settings()
    if family == "hysteretic":
        given[4][3] = 0.5
    given[4][row] = value
    change = [np.zeros_like(v) for v in given]
    change[4][row] = 1.0
    weights = np.random.default_rng(8).normal(size=(2, 60))
    tangent = KERNELS[family]["response_tangent"](*given, *where, *change)
    gradient = KERNELS[family]["response_gradient"](*given, *where, weights)
    assert abs((weights * tangent).sum() - inner(gradient, change)) < 1e-6 * np.abs(weights * tangent).sum()
    nothing = KERNELS[family]["response_tangent"](*given, *where, *(0.0 * d for d in change))
    np.testing.assert_array_equal(nothing, np.zeros((2, 60)))


def gradient_errors(family, given, where, exact):
    """Error of the gradient along a direction, for cotangents that are the exact derivative and noise.

    Beside the product of the cotangent's norm and the derivative's.
    """
    errors = []
    for change, derivative in exact:
        noise = np.random.default_rng(13).normal(size=derivative.shape)
        for cotangent in (derivative, noise):
            gradient = KERNELS[family]["response_gradient"](*given, *where, cotangent)
            error = inner(gradient, change) - (cotangent * derivative).sum()
            errors.append(abs(error) / (np.linalg.norm(cotangent) * np.linalg.norm(derivative)))
    return np.array(errors)


@pytest.mark.parametrize("family", KERNELS)
@pytest.mark.parametrize("modal", [False, True], ids=["rayleigh", "modal"])
def test_against_differences_of_a_tight_ode_solution(family, modal):
    """Each row of parameters along a direction, to 1e-7: nothing of ours in it."""
    given = parameters(family, 2, modal=modal, seed=9)
    where = settings(2, n_times=12, quantity=3, sensors=(0, 1), seed=10)
    rows = [(0, slice(None)), (1, slice(None))] + [(4, k) for k in range(len(given[4]))]
    rows += [(3, slice(None))] if modal else [(2, 0), (2, 1)]
    exact = []

    def exact_displacements(given):
        return tight_solution(given, where[0], DT, at_kinks=True)["relative_displacement"]

    for p, row in rows:
        change = [np.zeros_like(v) for v in given]
        change[p][row] = directions(given, 11)[p][row]
        derivative = differences(exact_displacements, given, change, 1e-4)
        exact.append((change, derivative))
    errors = gradient_errors(family, given, where, exact)
    assert errors.max() < 1e-7, errors


@pytest.mark.parametrize("family", KERNELS)
def test_accuracy_over_a_record(family, record):
    """1e-6 against differences of a response in steps six times finer, for histories."""
    given = parameters(family, 5, seed=12)
    where = (record.acceleration[:600], record.dt, 1, 1, np.arange(5), 5, 0)
    change = directions(given, 13)

    def fine(q):
        return nonlinear_histories(NONLINEAR[family], q, Excitation(*where[:4]), where[4], [0], 6)[0]

    exact = differences(fine, given, change, 1e-5)
    assert gradient_errors(family, given, where, [(change, exact)]).max() < 1e-6


@pytest.mark.parametrize("family", KERNELS)
@pytest.mark.parametrize(("p", "bad"), [(0, np.nan), (1, -1.0), (2, np.inf), (3, np.nan), (4, -1.0)])
def test_no_structure_gives_nan(family, p, bad):
    given, where = parameters(family), settings(n_times=10)
    response, observed = data(family, given, where)
    change = directions(given)
    given[p][..., -1] = bad
    kernels = KERNELS[family]
    results = [
        kernels["response"](*given, *where),
        kernels["discrepancy"](*given, *where, observed),
        kernels["misfit"](*given, *where, observed),
        *kernels["response_gradient"](*given, *where, response),
        *kernels["misfit_gradient"](*given, *where, observed, np.ones((2, 4))),
        kernels["response_tangent"](*given, *where, *change),
        kernels["discrepancy_tangent"](*given, *where, observed, *change),
    ]
    assert all(np.isnan(r).all() for r in results)


def test_too_many_steps_give_nan():
    """A yield displacement far too small for the motion; the next particle is none the worse."""
    given, where = parameters("hysteretic"), settings(n_times=10)
    _, observed = data("hysteretic", given, where)
    table = np.stack([given[4], given[4]])
    table[0, 0] = 1e-12
    population = (*(v[None] for v in given[:4]), table)
    gradient = KERNELS["hysteretic"]["population_gradient"](*population, *where, observed, np.ones((2, 2)))
    assert np.isnan(gradient[4][0]).all()
    assert np.isfinite(gradient[4][1]).all()


@pytest.mark.parametrize("family", KERNELS)
def test_sizes_that_disagree(family):
    kernels, given, where = KERNELS[family], parameters(family), settings(n_times=10)
    response, observed = data(family, given, where)
    short, fewer = observed[:, :-1], (*given[:4], given[4][:, :2])
    for name, more in (
        ("discrepancy", (short,)),
        ("misfit", (short,)),
        ("response_gradient", (short,)),
        ("misfit_gradient", (short, np.ones((2, 4)))),
        ("misfit_gradient", (observed, np.ones((3, 4)))),
        ("misfit_gradient", (observed, np.ones((2, 2)))),
        ("discrepancy_tangent", (short, *given)),
        ("response_tangent", fewer),
    ):
        with pytest.raises(ValueError, match="must have the shape"):
            kernels[name](*given, *where, *more)
    population = (*(v[None] for v in given[:4]), np.stack([given[4]] * 2))
    with pytest.raises(ValueError, match="one row, or one for each particle"):
        kernels["population_misfit"](np.ones((3, 3)), *population[1:], *where, observed)
    for law in (np.ones((7, 3)), fewer[4]):
        with pytest.raises(ValueError, match=r"`law` must have the shape \(., 3\) of 3 springs, got"):
            kernels["response_gradient"](*given[:4], law, *where, response)
    with pytest.raises(ValueError, match="`stiffness` must have the shape"):
        kernels["misfit"](given[0], np.ones(2), *given[2:], *where, observed)
    with pytest.raises(ValueError, match="`sensors` must be degrees of freedom from 0 to 2, got .3."):
        kernels["misfit"](*given, *where[:4], np.array([3]), 3, 0, observed)
    with pytest.raises(ValueError, match="`n_modes` must be all 3 of a nonlinear chain, got 2"):
        kernels["misfit"](*given, *where[:5], 2, 0, observed)
