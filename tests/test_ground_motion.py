"""Synthetic earthquakes: reproducible, scaled, enveloped, and with the spectrum they claim."""

import math

import numpy as np
import pytest
from scipy import signal, stats

from pymc_features.ground_motion import AminAng, CloughPenzien, synthetic_earthquake
from support.refusals import refusals

OMEGA_G = 5.0 * math.pi


def test_seed_decides_and_global_state_does_not():
    np.random.seed(1)
    state = np.random.get_state()[1].copy()
    first, second = synthetic_earthquake(random_seed=5), synthetic_earthquake(random_seed=5)
    np.testing.assert_array_equal(first.acceleration, second.acceleration)
    np.testing.assert_array_equal(state, np.random.get_state()[1])
    one, another = synthetic_earthquake(), synthetic_earthquake()
    assert abs(np.corrcoef(one.acceleration, another.acceleration)[0, 1]) < 0.3
    assert (first.name, one.name) == ("synthetic 5", "synthetic")


@pytest.mark.parametrize(("duration", "dt", "pga"), [(0.02, 0.02, 1e-6), (1.0, 1 / 120, np.float64(7.3))])
def test_number_of_samples_and_pga_that_only_scales(duration, dt, pga):
    record = synthetic_earthquake(duration, dt, 9, pga=pga)
    assert record.n_times == round(duration / dt) + 1 and record.pga == pga
    unit = synthetic_earthquake(duration, dt, 9, pga=1.0)
    np.testing.assert_allclose(record.acceleration, pga * unit.acceleration, rtol=1e-14)


def test_envelope_is_that_of_amin_and_ang():
    """The ratio to the same draw under a flat envelope is the envelope, up to one factor."""
    shape = AminAng(rise_time=4.0, strong_time=6.0, end_level=0.1)
    flat = AminAng(rise_time=0.0, strong_time=30.0)
    shaped = synthetic_earthquake(30.0, 0.02, 2, envelope=shape)
    ratio = shaped.acceleration / synthetic_earthquake(30.0, 0.02, 2, envelope=flat).acceleration
    t = shaped.time
    strong = (t >= 4.0) & (t <= 10.0)
    expected = np.where(t < 4.0, (t / 4.0) ** 2, np.where(strong, 1.0, 0.1 ** ((t - 10.0) / 20.0)))
    np.testing.assert_allclose(ratio / ratio[strong][0], expected, rtol=1e-9, atol=1e-12)
    assert shaped.acceleration[0] == 0.0


def clough_penzien(omega, omega_g, zeta_g, omega_f, zeta_f):
    """The closed form, written out from the book."""
    r, s = omega / omega_g, omega / omega_f
    kanai_tajimi = (1 + (2 * zeta_g * r) ** 2) / ((1 - r**2) ** 2 + (2 * zeta_g * r) ** 2)
    return kanai_tajimi * s**4 / ((1 - s**2) ** 2 + (2 * zeta_f * s) ** 2)


def spectrum_statistic(settings, dt, filters, n_bands=20, n_records=4):
    """Chi-square of band averages of periodogram over PSD, scale-free; n_bands - 1 degrees.

    Each ordinate of a Hann-windowed periodogram is exponential with mean S; those one and two bins
    apart correlate by (2/3)^2 and (1/6)^2, so the mean of K has variance 1.944 S^2 / K. Dividing by
    the overall mean takes away one degree of freedom (the records are scaled to their peak).
    """
    ratios = []
    for seed in range(n_records):
        record = synthetic_earthquake(
            160.0, dt, seed, spectrum=CloughPenzien(**settings), envelope=AminAng(0.0, 160.0)
        )
        frequency, periodogram = signal.periodogram(
            record.acceleration, 1.0 / dt, window="hann", detrend=False
        )
        keep = slice(10, -10)
        ratio = periodogram[keep] / clough_penzien(2.0 * np.pi * frequency[keep], *filters)
        ratios.append(ratio / ratio.mean())
    bands = np.array_split(np.mean(ratios, axis=0), n_bands)
    chi_square = [(band.mean() - 1.0) ** 2 * band.size * n_records / 1.944 for band in bands]
    return float(np.sum(chi_square))


DEFAULTS = (OMEGA_G, 0.6, 0.1 * OMEGA_G, 0.6)
FALSE_ALARM = 1e-3
LIMIT = stats.chi2.isf(FALSE_ALARM, 19)


@pytest.mark.parametrize("dt", [0.02, 0.01])
@pytest.mark.parametrize(
    ("settings", "filters"),
    [
        ({}, DEFAULTS),
        ({"omega_g": 9.0, "zeta_g": 0.35, "omega_f": 2.0, "zeta_f": 0.8}, (9.0, 0.35, 2.0, 0.8)),
    ],
)
def test_spectrum_is_clough_penzien(dt, settings, filters):
    """Fixed seeds; a correct generator fails one of four cases with probability 4e-3."""
    assert spectrum_statistic(settings, dt, filters) < LIMIT


@pytest.mark.parametrize(
    "wrong",
    [
        (1.2 * OMEGA_G, 0.6, 0.1 * OMEGA_G, 0.6),
        (OMEGA_G, 0.75, 0.1 * OMEGA_G, 0.6),
        (OMEGA_G, 0.6, 0.2 * OMEGA_G, 0.6),
    ],
    ids=["omega_g", "zeta_g", "omega_f"],
)
def test_spectrum_test_sees_a_wrong_filter(wrong):
    assert spectrum_statistic({}, 0.02, wrong) > LIMIT


def test_stationary_part_is_gaussian():
    """Jarque-Bera on samples a second apart, false alarm 1 %; under an envelope it must fail."""
    flat = synthetic_earthquake(400.0, 0.02, 4, envelope=AminAng(0.0, 400.0)).acceleration[::50]
    assert stats.jarque_bera(flat).pvalue > 0.01
    shaped = synthetic_earthquake(400.0, 0.02, 4).acceleration[::50]
    assert stats.jarque_bera(shaped).pvalue < 1e-6


def test_end_is_not_wrapped_around_to_the_start():
    """A circular filter without its tail cut off correlates the last sample with the first."""
    flat = AminAng(rise_time=0.0, strong_time=5.0)
    pairs = np.array(
        [synthetic_earthquake(5.0, 0.02, seed, envelope=flat).acceleration[[0, 1, -1]] for seed in range(300)]
    )
    correlation = np.corrcoef(pairs.T)
    assert correlation[0, 1] > 0.8
    assert abs(correlation[0, 2]) < 4.0 / math.sqrt(300)


INADMISSIBLE_ARGUMENTS_VALUES = {  # what is said: what is given
    "`duration` must be positive, got 0.0": {"duration": 0.0},
    "`duration` must be at least one step of 0.02 s, got 0.005": {"duration": 0.005},
    "`dt` must be positive, got nan": {"dt": math.nan},
    "`pga` must be positive, got inf": {"pga": math.inf},
    "`zeta_g` must be positive, got 0.0": {"spectrum": {"zeta_g": 0.0}},
    "`omega_f` must be positive, got 0.0": {"spectrum": {"omega_f": 0.0}},
    "`omega_f` must be below the Nyquist .*got 158 rad/s. Take a": {"spectrum": {"omega_f": 158.0}},
    "`rise_time` must be positive or zero, got -1.0": {"envelope": {"rise_time": -1.0}},
    "`end_level` must be positive, got 0.0": {"envelope": {"end_level": 0.0}},
    "`end_level` must be at most 1, the plateau, got 1.5": {"envelope": {"end_level": 1.5}},
    "`random_seed` must be an integer of at least 0, got -1": {"random_seed": -1},
}
INADMISSIBLE_ARGUMENTS_TYPES = {
    "`strong_time` must be a number, got 'a'": {"envelope": {"strong_time": "a"}},
    "`spectrum` must be CloughPenzien\\(...\\), got float": {"spectrum": 1.0},
    "`envelope` must be AminAng\\(...\\), got float": {"envelope": 1.0},
}


@refusals("arguments", INADMISSIBLE_ARGUMENTS_VALUES, INADMISSIBLE_ARGUMENTS_TYPES)
def test_inadmissible_arguments(arguments, error, match):
    parts = {"spectrum": CloughPenzien, "envelope": AminAng}
    with pytest.raises(error, match=match):
        made = {n: parts[n](**v) if isinstance(v, dict) else v for n, v in arguments.items()}
        synthetic_earthquake(**made)
