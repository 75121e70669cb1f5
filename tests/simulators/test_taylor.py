"""Populations of nonlinear chains by Taylor steps: statistics, gradients, and spans of fine records."""

import numpy as np
import pytest

from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.families import FAMILIES as FAMILY
from pymc_features.simulators.nonlinear import kernels
from pymc_features.simulators.nonlinear.law import SERIES
from pymc_features.simulators.numbers.vectors import LANES
from pymc_features.simulators.oscillators.arguments import NO_DIRECT, Excitation
from pymc_features.simulators.taylor import ground, layout
from pymc_features.simulators.taylor.ground import Ground
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
    together = gradient(family, (*linear, values), where, 0.5 * response, weights[..., None])
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


STEP = 3e-6  # of a parameter: small enough for the choices that a march makes
ROUNDING = 3e-15  # of L
SHARPNESS = 2  # row of the law
SMOOTH = {name: case for name, case in CASES.items() if "sharpness" not in case[0]}  # n = 1 and 2


def gradient(family, parameters, where, observed, weights):
    *record, sensors, n_modes, quantity = where
    given = FAMILY[family].assemble([*parameters, *record, NO_DIRECT, sensors, n_modes], quantity)
    return FAMILY[family].kernels["population_gradient"](*given, observed, weights)


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


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("case", SMOOTH)
def test_gradient_is_that_of_the_march(family, case):
    """1e-6 of the largest derivative by a parameter of its kind, in each particle, hardly yielding or far."""
    chains, request = SMOOTH[case]
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
    parameters, where = population("hysteretic"), shaken(**SMOOTH[case][1])
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


RATE = 50.0  # [rad/s], about that of the chains


@pytest.fixture
def set_tolerance(monkeypatch):
    """Change what may be lost in all spans that are found from then on."""

    def change(tolerance, excess=ground.EXCESS):
        monkeypatch.setattr(ground, "TOLERANCE", tolerance)
        monkeypatch.setattr(ground, "EXCESS", excess)
        ground.ground_from.cache_clear()

    yield change
    ground.ground_from.cache_clear()


def fine(n_times=601, **request):
    return shaken(n_times=n_times, stride=10, dt=0.001, **request)


def cut(where, rate=RATE, series=None):
    """The spans of a record, for the recurrence that is named first unless another is given."""
    return Ground(Excitation(*where[:4])).spans(rate, series or next(iter(SERIES.values())))


def test_spans_shorten_for_stiff_chains_and_rough_records():
    smooth, rough = fine(band=40.0), fine()
    counts = [len(cut(smooth, rate).widths) for rate in (RATE, 10.0 * RATE, 1000.0 * RATE)]
    assert counts[0] == 61
    assert counts[0] < counts[1] < counts[2] == 601
    assert (cut(rough).widths == 1).all()
    assert (cut((0.0 * smooth[0], *smooth[1:])).widths == 10).all()
    for request in ({"stride": 1}, {"stride": 4, "substeps": 2}):  # every sample, or shorter steps
        assert (cut(shaken(band=1.0, dt=0.001, n_times=81, **request)).widths == 1).all()


def ends(family, parameters, where, lengths):
    """Responses at the ends of shorter records (length, particle, sensor)."""
    found = []
    for n_times in lengths:
        data = np.zeros((len(where[4]), n_times // 10 + 1))
        request = (where[0][:n_times], *where[1:])
        found.append(-KERNELS[family]["population_misfit"](*parameters, *request, data)[..., 3])
    return np.array(found)


def differences(family, parameters, where, set_tolerance, *tolerance):
    """Of root mean squares of misfits, and of responses, between spans and single samples, over the peak."""
    exact = history(family, parameters, where, 0)
    peak, lengths = np.abs(exact).max(), range(201, 602, 50)
    observed = exact + 0.1 * peak * np.random.default_rng(3).normal(size=exact.shape)
    found = []
    for values in ((-1.0,), tolerance):
        set_tolerance(*values)
        errors = KERNELS[family]["population_discrepancy"](*parameters, *where, observed)
        found.append((np.sqrt(errors), ends(family, parameters, where, lengths)))
    return [np.abs(a - b).max() / peak for a, b in zip(*found, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_smooth_record(family, set_tolerance):
    """Band-limited at 40 Hz: one span to an output."""
    where = fine(band=40.0, scale=20.0)
    of_errors, of_responses = differences(family, population(family), where, set_tolerance, ground.TOLERANCE)
    assert (cut(where).widths[:-1] == 10).mean() > 0.9
    assert 0.0 < of_errors < 1e-6
    assert of_responses < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_rough_record(family, set_tolerance):
    """White: single samples, and long spans would be wrong."""
    parameters, where = list(population(family)), fine(scale=20.0)
    parameters[1] = 60.0 * parameters[1]
    if family == "hysteretic":
        parameters[4][:, 0] /= 60.0
    differ = differences(family, parameters, where, set_tolerance, ground.TOLERANCE)
    assert max(differ) < 1e-6
    wrong = differences(family, parameters, where, set_tolerance, np.inf, np.inf)
    assert max(wrong) > 1e-5
