"""Gradients of populations of nonlinear chains: derivatives of what the Taylor march computes."""

import numpy as np
import pytest

from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.nonlinear import kernels
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from pymc_features.simulators.taylor import layout
from simulators.test_taylor import CASES as MARCHES
from simulators.test_taylor import FAMILIES as NAMES
from simulators.test_taylor import KERNELS, PARTICLES, history, particle, population, shaken

pytestmark = pytest.mark.slow  # each family has kernels of its own

STEP = 3e-6  # of a parameter: small enough for the choices that a march makes
ROUNDING = 3e-15  # of L
SHARPNESS = 2  # row of the law
CASES = {name: case for name, case in MARCHES.items() if "sharpness" not in case[0]}  # n = 1 and 2


def gradient(family, parameters, where, observed, weights):
    *record, sensors, n_modes, quantity = where
    given = FAMILIES[family].assemble([*parameters, *record, NO_DIRECT, sensors, n_modes], quantity)
    return FAMILIES[family].kernels["population_gradient"](*given, observed, weights)


def inside(family, parameters):
    """With a row for each particle, and away from the bounds of all parameters."""
    count = len(parameters[1])
    parameters = [np.repeat(p, count, axis=0) if len(p) == 1 else p.copy() for p in parameters]
    if family == "hysteretic":
        parameters[4][:, 4] *= 0.8
    if not parameters[3].any():
        return parameters
    parameters[2][:] = 0.05, 2e-4
    return parameters


def noisy(family, parameters, where, seed=2):
    response = history(family, parameters, where, 0)
    return response + 0.3 * np.abs(response).max() * np.random.default_rng(seed).normal(size=response.shape)


def is_any(values):
    """Whether a sharpness is neither one nor two, so that it has a derivative."""
    return not np.isin(values[:, SHARPNESS], (1.0, 2.0)).all()


def entries(family, parameters):
    """All that can be differentiated: number and index of a parameter, and the row that it is compared in."""
    for p, values in enumerate(parameters):
        for i in np.ndindex(values.shape[1:]):
            fixed = p == 4 and family == "hysteretic" and i[0] == SHARPNESS and not is_any(values)
            if not fixed and values.any():
                yield p, i, (p, i[0] if p in (2, 4) else 0)


def errors_of_gradient(family, parameters, where, observed, weights):
    """Largest difference to central differences of the same march, beside the largest of its row."""
    ours = gradient(family, parameters, where, observed, weights)

    def weighted(p, change):
        moved = [*parameters[:p], parameters[p] + change, *parameters[p + 1 :]]
        sums = KERNELS[family]["population_misfit"](*moved, *where, observed)
        return (sums[..., : weights.shape[2]] * weights).sum(axis=(1, 2))

    size = np.abs(weighted(0, 0.0))
    errors, sizes = {}, {}
    for p, i, row in entries(family, parameters):
        change = np.zeros_like(parameters[p])
        change[:, *i] = STEP * parameters[p][:, *i]
        coarse = weighted(p, change) - weighted(p, -change)
        fine = weighted(p, 0.5 * change) - weighted(p, -0.5 * change)
        exact = (8.0 * fine - coarse) / 6.0  # over the change
        jump = np.abs(coarse - 2.0 * fine)  # 1e-9 of them, and more where the number of steps changes
        error = np.abs(exact - (ours[p] * change)[:, *i]) - ROUNDING * size - jump
        errors[row] = np.maximum(errors.get(row, 0.0), error)
        sizes[row] = np.maximum(sizes.get(row, 0.0), np.abs(exact))
    return {row: errors[row] / sizes[row] for row in errors}


@pytest.mark.parametrize("family", NAMES)
@pytest.mark.parametrize("case", CASES)
def test_gradient_is_that_of_the_march(family, case):
    """1e-6 of the largest derivative by a parameter of its kind, in each particle, hardly yielding or far."""
    chains, request = CASES[case]
    parameters, where = inside(family, population(family, **chains)), shaken(**request)
    observed = noisy(family, parameters, where)
    several = case == "modal damping, coarse velocity"
    if not several:
        observed[0, 4:9] = np.nan
    parameters[1][1] *= 4.0  # stays almost linear
    weights = np.random.default_rng(5).normal(size=(PARTICLES, len(observed), 4 if several else 1))
    before = kernels.PARTICLES["taylor gradients"]
    errors = errors_of_gradient(family, parameters, where, observed, weights)
    assert kernels.PARTICLES["taylor gradients"] == before + len(weights)
    assert max(e.max() for e in errors.values()) < 1e-6, errors


@pytest.mark.parametrize(
    ("sharpness", "factor", "median", "most"),
    [(1.2, 8.0, 2e-5, 2e-4), (1.5, 0.25, 2e-5, 4e-4), (3.0, 0.25, 1e-7, 1e-5), (4.5, 1.0, 2e-7, 1e-5)],
)
def test_any_sharpness(sharpness, median, most, factor):
    """Of n as well; where |z|^n is not smooth at zero, what the choice of polynomials adds is left out.

    The bounds are for central differences of the same march. Derivatives by the dashpots' coefficients are
    left out: they may nearly vanish in a particle, whose error is then up to 1e-3 of them.
    """
    chains = inside("hysteretic", population("hysteretic", sharpness=(sharpness,)))
    chains[4][:, 0] *= factor
    chains[1][1] *= 4.0  # stays almost linear
    where = shaken()
    observed = noisy("hysteretic", chains, where)
    weights = np.random.default_rng(5).normal(size=(PARTICLES, len(observed), 1))
    before = kernels.PARTICLES["taylor gradients"]
    errors = errors_of_gradient("hysteretic", chains, where, observed, weights)
    assert kernels.PARTICLES["taylor gradients"] == before + len(weights)
    assert (4, SHARPNESS) in errors
    errors = {row: e for row, e in errors.items() if row[0] != 2}
    assert max(np.median(e) for e in errors.values()) < median, errors
    assert max(e.max() for e in errors.values()) < most, errors


@pytest.mark.parametrize("case", ["acceleration", "fine record"])
def test_a_short_tape(case, monkeypatch):
    """The march is repeated for what the tape has no room for: the same numbers."""
    parameters, where = population("hysteretic"), shaken(**CASES[case][1])
    observed = noisy("hysteretic", parameters, where)
    weights = np.ones((PARTICLES, len(observed), 1))
    whole = gradient("hysteretic", parameters, where, observed, weights)
    monkeypatch.setattr(layout, "ROOM", 1)
    in_parts = gradient("hysteretic", parameters, where, observed, weights)
    for a, b in zip(whole, in_parts, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize(
    ("row", "value", "by_taylor_steps"), [(0, 1e-12, 0), (SHARPNESS, 7.3, 2), (4, 0.9, 2)]
)
def test_particles_that_are_left_to_others(row, value, by_taylor_steps):
    """One that is given up, with its neighbours; sharper than Taylor steps serve; no structure."""
    parameters, where = inside("hysteretic", population("hysteretic", p=3)), shaken(n_times=20)
    observed = noisy("hysteretic", parameters, where)
    weights = np.ones((3, len(observed), 1))
    parameters[4][1, row, 0] = value
    before = kernels.PARTICLES["taylor gradients"]
    found = gradient("hysteretic", parameters, where, observed, weights)
    assert kernels.PARTICLES["taylor gradients"] == before + by_taylor_steps
    assert np.isfinite(found[1][[0, 2]]).all()
    assert np.isfinite(found[1][1]).all() == (row == SHARPNESS)
    for k in np.flatnonzero(np.isfinite(found[1]).all(axis=1)):
        alone = KERNELS["hysteretic"]["misfit_gradient"](
            *particle(parameters, k), *where, observed, weights[k]
        )
        np.testing.assert_allclose(found[1][k], alone[1], atol=1e-4 * np.abs(alone[1]).max())
