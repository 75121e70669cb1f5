"""Populations of nonlinear chains by Taylor steps: single particles, linear limits, what is let go."""

import numpy as np
import pytest

from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.families import FAMILIES as FAMILY
from pymc_features.simulators.nonlinear import kernels
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.kernels import flat_kernels, population_discrepancy, population_gradient, response_gradient
from support.reference import misfit_statistics
from support.yielding import tight_solution

pytestmark = pytest.mark.slow  # they wait for kernels

FAMILIES = ("hysteretic", "duffing")


KERNELS = {family: flat_kernels(family) for family in FAMILIES}

PARTICLES = 11  # a vector of any width and a part of one; the same numbers whatever the width


def population(family, n=3, p=PARTICLES, *, modal=False, sharpness=(1.0, 2.0), seed=0):
    """Chains of different springs that yield, or harden several times, under the records below."""
    rng = np.random.default_rng(seed)
    values = np.full((p, 1, n), 1e6)
    if family == "hysteretic":
        values = np.tile(np.array([0.008, 0.1, 2.0, 0.5, 0.4])[:, None], (p, 1, n))
    values = values * rng.uniform(0.8, 1.2, values.shape)
    if family == "hysteretic":
        values[:, 4] = np.minimum(values[:, 3:5].min(axis=1), 0.45)
        values[:, 2] = rng.choice(sharpness, (p, n))
    rayleigh, ratios = np.array([[0.2, 1e-3]]), np.zeros((1, n))
    if modal:
        rayleigh, ratios = np.zeros((1, 2)), rng.uniform(0.02, 0.05, (p, n))
    return rng.uniform(0.8, 1.2, (p, n)), rng.uniform(300.0, 400.0, (p, n)), rayleigh, ratios, values


def shaken(n=3, *, n_times=60, substeps=1, stride=1, quantity=0, dt=0.02, scale=3.0, band=None, rough=0.0):
    """Arguments behind the parameters, all sensors but the first.

    The record is white, or has a `band` [Hz] and grows, in its last third with a white part.
    """
    noise = np.random.default_rng(1).normal(size=n_times)
    acceleration = scale * noise
    if band is not None:
        below = 1.0 / (1.0 + (np.fft.rfftfreq(n_times, dt) / band) ** 8)
        acceleration = np.fft.irfft(np.fft.rfft(noise) * below, n_times)
        acceleration *= scale / np.abs(acceleration).max() * np.minimum(np.arange(n_times) / 50.0, 1.0)
        acceleration[-n_times // 3 :] += rough * noise[-n_times // 3 :]
    return acceleration, dt, substeps, stride, np.arange(n)[::-1][: max(n - 1, 1)], n, quantity


def particle(parameters, k):
    return [p[k % len(p)] for p in parameters]


def history(family, parameters, where, k):
    return KERNELS[family]["response"](*particle(parameters, k), *where)


ANY = (1.0, 1.2, 1.5, 2.0, 3.3, 5.0)
CASES = {  # chains, requests
    "any sharpness": ({"sharpness": ANY}, {}),
    "acceleration": ({}, {}),
    "blocks of springs": ({"n": 21}, {"n": 21, "n_times": 30}),
    "modal damping, coarse velocity": ({"modal": True}, {"stride": 3, "quantity": 2}),
    "fine displacement, one mass": ({"n": 1}, {"n": 1, "substeps": 3, "n_times": 30, "quantity": 3}),
    "fine record": (
        {},
        {"n_times": 451, "stride": 10, "quantity": 1, "dt": 0.001, "band": 40.0, "rough": 0.3, "scale": 20.0},
    ),
    "coarse record": ({}, {"dt": 0.1, "n_times": 20, "scale": 1.0}),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("case", CASES)
def test_statistics_are_those_of_one_particle(family, case):
    """Errors of 1e-6 of the peak in the mean, 5e-6 where a reversal grazes zero; NaN where gaps say so."""
    chains, request = CASES[case]
    parameters, where = population(family, **chains), shaken(**request)
    exact = [history(family, parameters, where, k) for k in range(len(parameters[1]))]
    peak = np.abs(exact).max()
    observed = exact[0] + 0.1 * peak * np.random.default_rng(2).normal(size=exact[0].shape)
    for gaps in (False, True):
        if gaps:
            observed[0, 4:9] = np.nan
        before = kernels.PARTICLES["taylor"]
        sums = KERNELS[family]["population_misfit"](*parameters, *where, observed)
        assert kernels.PARTICLES["taylor"] == before + len(sums)
        for k, response in enumerate(exact):
            expected = misfit_statistics(observed - response)
            if gaps:
                expected[0, 0] = np.nansum((observed[0] - response[0]) ** 2) / observed.shape[1]
            bound = 2.0 * np.sqrt(expected[:, :2]) * [1e-6 * peak, 2e-6 * peak]  # of a mean square
            assert (np.abs(sums[k, :, :2] - expected[:, :2]) < bound)[np.isfinite(bound)].all()
            np.testing.assert_array_equal(np.isnan(sums[k]), np.isnan(expected))
            np.testing.assert_allclose(sums[k, :, 2:], expected[:, 2:], rtol=0, atol=5e-6 * peak)
        errors = KERNELS[family]["population_discrepancy"](*parameters, *where, observed)
        np.testing.assert_array_equal(errors, sums[..., 0])


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("quantity", range(len(QUANTITIES)), ids=QUANTITIES)
@pytest.mark.parametrize("modal", [False, True], ids=["rayleigh", "modal"])
def test_linear_limit(family, quantity, modal):
    """The kernels of the linear chain, which are exact; shared parameters have the sum of the gradients."""
    *linear, values = population(family, 4, modal=modal)
    values[:, 1 if family == "hysteretic" else 0] = float(family == "hysteretic")
    where, kernels = shaken(4, n_times=200, quantity=quantity), KERNELS[family]
    response = history(family, (*linear, values), where, 0)
    data = 0.0 * response  # all of the mean square is the response's
    ours = kernels["population_discrepancy"](*linear, values, *where, data)
    np.testing.assert_allclose(ours, population_discrepancy(*linear, *where, data), rtol=1e-6)
    weights = np.random.default_rng(6).normal(size=(PARTICLES, len(data)))
    given = FAMILY[family].assemble([*linear, values, *where[:4], NO_DIRECT, *where[4:6]], quantity)
    together = FAMILY[family].kernels["population_gradient"](*given, 0.5 * response, weights[..., None])
    alone = kernels["response_gradient"](*particle((*linear, values), 0), *where, response)
    pairs = [
        *zip(together[:4], population_gradient(*linear, *where, 0.5 * response, weights), strict=True),
        *zip(alone[:4], response_gradient(*particle(linear, 0), *where, response), strict=True),
    ]
    for i, (a, b) in enumerate(pairs):
        if i % 4 < 3 + modal:
            assert a.shape == b.shape
            limit = 2e-6 if i < 4 else 1e-5  # of single steps
            assert (np.abs(a - b) < limit * np.abs(b).max(axis=-1, keepdims=True)).all()


def test_particles_that_taylor_steps_leave_to_others():
    """No structure, another law, too fast: each in its own row, whatever its lane; the others keep theirs."""
    parameters, where = list(population("hysteretic", p=2 * LANES + 1)), shaken()
    observed = history("hysteretic", parameters, where, 0) + 1.0
    before = KERNELS["hysteretic"]["population_misfit"](*parameters, *where, observed)
    changed = [p.copy() for p in parameters]
    changed[0][1, 0] = -1.0
    changed[1][2, 1] = np.nan
    changed[4][4, 4] = 0.9  # gamma above beta
    changed[4][5, 2, 1] = 7.3  # sharper than the recurrence serves
    changed[4][LANES + 2, 0] = 1e-4  # yields at once, and far
    changed[4][LANES + 3, 0] = 1e-12
    kernels.PARTICLES.clear()
    after = KERNELS["hysteretic"]["population_misfit"](*changed, *where, observed)
    rows = [1, 2, 4, 5, LANES + 2, LANES + 3]
    assert np.isnan(after[[1, 2, 4, LANES + 3]]).all()
    for k in (5, LANES + 2):
        alone = KERNELS["hysteretic"]["misfit"](*particle(changed, k), *where, observed)
        np.testing.assert_allclose(after[k], alone, rtol=2e-6)
    kept, unchanged = (np.delete(sums, rows, axis=0) for sums in (after, before))
    np.testing.assert_allclose(kept, unchanged, rtol=4e-6, atol=1e-9)
    assert kernels.PARTICLES["lost"] >= 1
    assert kernels.PARTICLES["runge_kutta"] >= 4 + kernels.PARTICLES["lost"]


def errors_alone(parameters, where, k, lengths):
    """Largest errors at the ends of shorter records, of the peak, of a chain alone in its vector.

    No stiffer neighbour shortens its steps then. The last misfits are the response at the end.
    """
    exact, alone = history("hysteretic", parameters, where, k), [p[k % len(p)][None] for p in parameters]
    for n_times in lengths:
        request, data = (where[0][:n_times], *where[1:]), np.zeros((len(exact), n_times))
        found = -KERNELS["hysteretic"]["population_misfit"](*alone, *request, data)[0, :, 3]
        yield np.abs(found - exact[:, n_times - 1]).max() / np.abs(exact).max()


def stiff_springs(sharpness):
    mass, stiffness, rayleigh, ratios, values = population("hysteretic", n=10, p=40, sharpness=(sharpness,))
    values[:, 0] /= 64.0  # yield displacement
    return mass, 80.0 * stiffness, 0.1 * rayleigh, ratios, values


def of_sharpness(*sharpness, **more):
    return population("hysteretic", sharpness=sharpness, **more)


LONG = shaken(10, n_times=201, dt=0.01, band=5.0)
FOUND_ONCE = {  # what errors of 3e-6 to 2e-4 came from: chains, record, chain, lengths, limit
    "a spring reverses twice within a step": (of_sharpness(1.0, 2.0, p=200), shaken(), 5, (42, 45, 60), 5e-6),
    "neighbours reverse within a step": (of_sharpness(1.0, p=200), shaken(), 124, range(33, 41), 5e-6),
    "n = 1 turns back from flow": (stiff_springs(1.0), LONG, 19, range(60, 202, 20), 1e-6),
    "n = 2 turns back from flow": (stiff_springs(2.0), LONG, 17, range(60, 202, 20), 1e-6),
    "masses that a kink moves are damped": (
        of_sharpness(1.0, 2.0, p=60, modal=True),
        shaken(),
        18,
        range(30, 61, 6),
        2e-6,
    ),
    "z turns back soon behind a kink": (
        of_sharpness(1.5, p=1500),
        shaken(scale=0.9),
        116,
        range(10, 61, 5),
        1e-5,
    ),
    "a last term is large": (of_sharpness(1.2, p=1500), shaken(scale=3.0), 89, range(10, 61, 5), 1e-5),
}


@pytest.mark.parametrize(("chains", "where", "k", "lengths", "limit"), FOUND_ONCE.values(), ids=FOUND_ONCE)
def test_errors_that_were_found_once(chains, where, k, lengths, limit):
    assert max(errors_alone(chains, where, k, lengths)) < limit


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(("rest", "blow", "rtol"), [(1e-2, 3.0, 2e-6), (1e-3, 10.0, 5e-6)])
def test_steps_follow_the_motion(family, rest, blow, rtol):
    """Rest, then a blow: the steps that are too long then are repeated, and again where it is strong."""
    parameters = population(family)
    acceleration, *others = shaken(n_times=60)
    acceleration[:30] *= rest
    acceleration[30:] *= blow
    where = (acceleration, *others)
    observed = np.zeros_like(history(family, parameters, where, 0))
    errors = KERNELS[family]["population_discrepancy"](*parameters, *where, observed)
    for k in range(len(errors)):
        expected = (history(family, parameters, where, k) ** 2).mean(axis=1)
        np.testing.assert_allclose(errors[k], expected, rtol=rtol)


@pytest.mark.parametrize("reach", [0.03, 0.001], ids=["hardly yielding", "strongly yielding"])
def test_any_sharpness_beside_scipy(reach):
    parameters, where = population("hysteretic", 2, p=4, sharpness=(1.2,)), shaken(2, n_times=30)
    parameters[4][:, 0] = reach
    parameters[4][:, 2] = np.array([1.05, 1.2, 1.5, 3.3])[:, None]
    sums = KERNELS["hysteretic"]["population_misfit"](*parameters, *where, np.zeros((1, 30)))
    for k in range(4):
        upper = tight_solution(particle(parameters, k), *where[:2])["absolute_acceleration"][1]
        np.testing.assert_allclose(sums[k, 0, 0], np.mean(upper**2), rtol=1e-6)
        assert abs(abs(sums[k, 0, 3]) - abs(upper[-1])) < 2e-6 * abs(upper).max()
