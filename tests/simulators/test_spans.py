"""Spans of samples of a fine record, each a polynomial: the numbers of single samples, in fewer steps."""

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from pymc_features.simulators.nonlinear.law import SERIES
from pymc_features.simulators.oscillators.arguments import Excitation
from pymc_features.simulators.taylor import ground
from pymc_features.simulators.taylor.ground import DEGREE, Ground, projection
from simulators.test_taylor import FAMILIES, KERNELS, history, population, shaken

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


@pytest.mark.parametrize("width", [2, 10])
def test_projection(width):
    """The remainder has no moments, and the matrix gives its second integral."""
    samples = np.random.default_rng(0).normal(size=width + 1)
    coefficients, remainder = projection(width)
    times = np.linspace(0.0, 1.0, 400 * width + 1)
    r = np.interp(times * width, np.arange(width + 1), samples)
    r = r - np.polynomial.polynomial.polyval(times, samples @ coefficients)
    for k in range(DEGREE + 1):
        assert abs(cumulative_simpson(r * times**k, x=times)[-1]) < 1e-6
    twice = cumulative_simpson(cumulative_simpson(r, x=times, initial=0.0), x=times, initial=0.0)
    np.testing.assert_allclose(samples @ remainder, twice[200::200], rtol=0, atol=1e-7)
    of_a_line = np.arange(width + 1.0) @ coefficients
    np.testing.assert_allclose(of_a_line, np.eye(DEGREE + 1)[1] * width, atol=1e-11)


def test_spans_follow_one_another():
    """Each begins where the one before ends, and those of one step are the record itself."""
    where = fine(band=40.0, rough=10.0)
    acceleration, found = where[0], cut(where)
    widths = found.widths[:-1]
    assert {1, 10} <= set(widths)
    starts = np.concatenate([[0], np.cumsum(widths)])
    np.testing.assert_array_equal(starts[found.first], np.arange(0, 601, 10))
    np.testing.assert_array_equal(found.ground, acceleration[::10])
    single = np.flatnonzero(widths == 1)
    rises = acceleration[starts[single] + 1] - acceleration[starts[single]]
    np.testing.assert_array_equal(found.loads[single, :2].T, [acceleration[starts[single]], rises])
    assert (found.loads[single, 2:] == 0.0).all()


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
