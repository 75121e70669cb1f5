"""`identify_modes`: against simulated modes, uncertainty laws, coverage; what it warns of and refuses."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy import signal

import pymc_features as pmf
from pymc_features.ambient.bands import band_transform, checked_bands
from pymc_features.ambient.free_modes import BandData, FreeModes, Posterior
from pymc_features.ambient.identify import each_once, without_tones
from pymc_features.exceptions import AmbientWarning
from pymc_features.simulators.spectra import Lines

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
try:
    from benchmarks.coverage import modes
finally:
    sys.path.pop(0)

FINER = 4  # steps of the simulation in one sample
TWO = np.array([1.0, 1.04]), np.array([0.01, 0.015]), np.array([[1.0, 2.0, 3.0], [1.0, 1.0, -1.0]])


def oscillations(f, zeta, n, dt, rng, integrals=0):
    """Accelerations (n,) of an oscillator of unit mass under a white force, or velocities, displacements."""
    omega = 2.0 * np.pi * f
    matrix, force = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]), np.array([[0.0], [1.0]])
    outputs = np.array([matrix[1], [0.0, 1.0], [1.0, 0.0]])[integrals : integrals + 1]
    system = signal.cont2discrete((matrix, force, outputs, np.array([[float(integrals == 0)]])), dt / FINER)
    b, a = signal.ss2tf(*system[:4])
    start = int(10.0 / (zeta * f * dt)) * FINER
    y = signal.lfilter(b[0], a, rng.standard_normal(n * FINER + start))[start:]
    return signal.decimate(y, FINER, ftype="fir")


def channels(f, zeta, shapes, duration, seed, dt=0.1, noise=0.5, integrals=0):
    """What sensors see of modes under independent white forces, with white noise."""
    rng, n, shapes = np.random.default_rng(seed), int(duration / dt), np.asarray(shapes)
    values = sum(
        shape[:, None] * oscillations(one, ratio, n, dt, rng, integrals)
        for one, ratio, shape in zip(f, zeta, shapes, strict=True)
    )
    values = values + noise * rng.standard_normal(values.shape)
    coords = {"sensor": [f"s{i}" for i in range(len(values))], "time": dt * np.arange(n)}
    return xr.DataArray(values, coords, ("sensor", "time"))


def test_values_and_gradients_in_all_coordinates():
    """Values against covariance matrices, gradients and second derivatives against differences."""
    rng = np.random.default_rng(2)
    measured = channels(*TWO, 300.0, 1)
    bands = checked_bands([0.9, 1.2], measured.sizes["time"], 0.1, 1)
    spectra = band_transform(measured.values, bands.bins, bands.weights, 0.1)
    lines = Lines(bands.frequencies, bands.weights, bands.gains, bands.starts)
    factor = np.array([[0.3, 0.0], [0.1 - 0.2j, 0.4]])
    centre = FreeModes(np.array([1.01, 1.05]), np.array([0.02, 0.01]), TWO[2], factor, 0.2).normalised()
    posterior = Posterior(BandData(spectra, lines, bands.limits[0], 300.0), centre)
    assert posterior.size == 2 + 2 + 2 * 2 + 4 + 1
    x = 0.1 * rng.standard_normal(posterior.size)
    [value], [slope] = posterior.value_and_gradient(x[None])
    modes, expected = posterior.modes(x), 0.0
    for k in np.flatnonzero(bands.weights):
        beta = modes.natural / bands.frequencies[k]
        h = bands.gains[k] / (1.0 - beta**2 - 2j * modes.ratios * beta)
        root = modes.shapes.T @ np.diag(h) @ modes.factor
        covariance = root @ root.conj().T + modes.error * np.eye(3)
        f = spectra[:, 0, k] + 1j * spectra[:, 1, k]
        expected -= 3.0 * np.log(np.pi) + np.linalg.slogdet(covariance)[1]
        expected -= (f.conj() @ np.linalg.solve(covariance, f)).real
    np.testing.assert_allclose(value, expected, rtol=1e-10)
    steps = 1e-5 * np.eye(posterior.size)
    up, down = (posterior.value_and_gradient(x + sign * steps) for sign in (1.0, -1.0))
    np.testing.assert_allclose(slope, (up[0] - down[0]) / 2e-5, rtol=1e-5, atol=1e-4)
    second = -(up[1] - down[1]) / 2e-5
    np.testing.assert_allclose(posterior.information(x), second, rtol=1e-4, atol=1e-3 * np.abs(second).max())


def test_one_mode_follows_the_uncertainty_laws():
    """Squared coefficients of variation of Au's laws for the band f (1 +- 8 zeta), to 10 % of their roots.

    S.-K. Au, Mech. Syst. Signal Process. 48 (2014) 15-33: for frequency zeta / (2 pi N B_f), for damping
    1 / (2 pi zeta N B_zeta), N cycles being measured.
    """
    f, zeta, cycles, kappa = 1.0, 0.01, 2000.0, 8.0
    measured = channels([f], [zeta], [[1.0, 2.0, 3.0]], cycles / f, 1, noise=0.02)
    found = pmf.identify_modes(measured, [f * (1.0 - kappa * zeta), f * (1.0 + kappa * zeta)])
    side = kappa / (kappa**2 + 1.0)
    b_f = 2.0 / np.pi * (np.arctan(kappa) - side)
    b_zeta = 2.0 / np.pi * (np.arctan(kappa) + side - 2.0 * np.arctan(kappa) ** 2 / kappa)
    z = found.damping_ratios[0]
    np.testing.assert_allclose(found.frequency_sd[0], f * np.sqrt(z / (2 * np.pi * cycles * b_f)), rtol=0.1)
    np.testing.assert_allclose(found.damping_sd[0], np.sqrt(z / (2 * np.pi * cycles * b_zeta)), rtol=0.1)
    assert abs(found.frequencies[0] - f) < 4.0 * found.frequency_sd[0]
    np.testing.assert_allclose(found.shapes[0], np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), atol=2e-3)
    assert (np.abs(found.shapes[0] - np.array([1, 2, 3]) / np.sqrt(14.0)) < 4.0 * found.shape_sd[0]).all()


def test_three_close_modes():
    """Frequencies 0.98, 1.00 and 1.02 Hz; their number is found as well."""
    f, zeta = np.array([0.98, 1.0, 1.02]), np.array([0.008, 0.01, 0.012])
    shapes = np.random.default_rng(3).normal(size=(3, 6))
    found = pmf.identify_modes(channels(f, zeta, shapes, 1200.0, 2, noise=0.05), [0.85, 1.15])
    assert found.frequencies.size == 3
    assert (np.abs(found.frequencies - f) < 4.0 * found.frequency_sd).all()
    assert (np.abs(found.damping_ratios - zeta) < 4.0 * found.damping_sd).all()
    assert np.diag(pmf.modal.mac(found.shapes, shapes)).min() > 0.9
    shapes /= np.linalg.norm(shapes, axis=1, keepdims=True)
    shapes *= np.sign((found.shapes * shapes).sum(axis=1, keepdims=True))
    assert (np.abs(found.shapes - shapes) < 4.5 * found.shape_sd).all()
    with pm.Model():  # what it says can be compared with a structure's modes
        natural = pm.LogNormal("f", np.log(f), 0.1, shape=3)
        pmf.ModalFeature("y", (natural, shapes), observed=found, sigma_f=0.01, sigma_phi=0.1)


@pytest.mark.statistical
def test_intervals_of_two_close_modes_cover():
    """5-95 % intervals of 60 simulations of two modes 4 % apart, 240 in all: covered by 90 %, +- 4 errors.

    Four standard errors of a binomial with independent entries, 7.7 %: a false alarm in 10,000. Half as wide
    intervals, the negative control, would cover 59 %.
    """
    f, zeta, shapes = TWO
    inside = []
    for seed in range(60):
        found = pmf.identify_modes(channels(*TWO, 600.0, seed), [0.85, 1.2], n_modes=2)
        assert found.frequencies.size == 2
        off = np.concatenate(
            [
                (found.frequencies - f) / found.frequency_sd,
                np.log(found.damping_ratios / zeta) * found.damping_ratios / found.damping_sd,
            ]
        )
        inside.append(np.abs(off)[:, None] < 1.645 * np.array([1.0, 0.5]))
    share, halved = np.mean(inside, axis=(0, 1))
    assert abs(share - 0.9) < 0.077
    assert abs(halved - 0.9) > 0.077


@pytest.mark.slow
def test_integrals_of_accelerations_have_the_same_modes():
    """Displacements of the same forces; the spectra are divided by (2 pi f)^4."""
    f, zeta = [0.5], [0.02]
    limits = [0.4, 0.6]
    by = {
        quantity: pmf.identify_modes(
            channels(f, zeta, [[1.0, 2.0]], 2000.0, 4, noise=1e-3, integrals=integrals),
            limits,
            quantity=quantity,
        )
        for integrals, quantity in enumerate(("acceleration", "velocity", "displacement"))
    }
    for other in ("velocity", "displacement"):
        np.testing.assert_allclose(by[other].frequencies, by["acceleration"].frequencies, rtol=1e-3)
        np.testing.assert_allclose(by[other].damping_ratios, by["acceleration"].damping_ratios, rtol=0.03)
        np.testing.assert_allclose(by[other].damping_sd, by["acceleration"].damping_sd, rtol=0.1)


def test_a_band_of_noise_has_no_mode():
    measured = channels([1.0], [0.01], [[1.0, 2.0]], 600.0, 5)
    with pytest.warns(AmbientWarning, match="the band 3 to 4 Hz has no mode: it is noise, or"):
        found = pmf.identify_modes(measured, [[0.9, 1.1], [3.0, 4.0]])
    assert found.frequencies.size == 1
    noise = measured.copy(data=np.random.default_rng(1).standard_normal(measured.shape))
    with (
        pytest.warns(AmbientWarning, match="no mode"),
        pytest.raises(ValueError, match="`bands` must be bands with modes, got none with any. Look at the"),
    ):
        pmf.identify_modes(noise, [3.0, 4.0])
    with pytest.raises(ValueError, match="`channels` must be of a structure .* without a peak. Pass"):
        pmf.ambient.propose_bands(noise, highest=4.0)


def test_a_short_record():
    measured = channels([1.0], [0.01], [[1.0, 2.0]], 60.0, 7, noise=0.05)
    with pytest.warns(AmbientWarning, match="a record of 60 s is short for the mode at .*are better"):
        pmf.identify_modes(measured, [0.8, 1.2], n_modes=1)


def test_a_machine_is_no_mode():
    """In a band of its own, and beside a mode: taken off, and said."""
    mode = channels([2.0], [0.01], [[1.0, 2.0]], 600.0, 8, noise=0.1)
    for f in (1.0003, 2.08):
        measured = mode + float(mode.std()) * np.sin(2.0 * np.pi * f * mode["time"])
        with pytest.warns(
            AmbientWarning, match=f"move at {f:.4g} Hz as by a machine at constant speed, no wider"
        ):
            found = pmf.identify_modes(measured, [[0.9, 1.1], [1.8, 2.2]])
        expected = pmf.identify_modes(mode, [1.8, 2.2])
        assert abs(found.frequencies - expected.frequencies) < 0.3 * expected.frequency_sd
        assert abs(found.damping_ratios - expected.damping_ratios) < 0.3 * expected.damping_sd


def test_what_comes_in_from_beside_is_no_wide_mode():
    """The tail of the mode at 2 Hz looks as one of 14 % damping in the band below."""
    measured = channels([2.0], [0.01], [[1.0, 2.0]], 600.0, 8, noise=0.1)
    with pytest.warns(
        AmbientWarning, match="the band 0.9 to 1.1 Hz has no mode: .* what comes in from beside"
    ):
        assert pmf.identify_modes(measured, [[0.9, 1.1], [1.8, 2.2]]).frequencies.size == 1
    assert pmf.identify_modes(measured, [[0.9, 1.1]], n_modes=1).damping_ratios > 0.1


def test_tones_are_taken_off_and_modes_are_not():
    """Frequencies to a hundredth of one over the duration; what is left is the channels without them."""
    rng, t = np.random.default_rng(4), 0.1 * np.arange(6000)
    quiet = rng.standard_normal((3, t.size))
    tones = np.array([0.71234, 2.5])
    sines = sum(rng.normal(size=(3, 1)) * np.sin(2.0 * np.pi * f * t + 1.0) for f in tones)
    left, found = without_tones(quiet + 2.0 * sines, 0.1)
    np.testing.assert_allclose(found, tones, atol=0.01 * 1.0 / 600.0)
    assert np.abs(left - quiet + quiet.mean(axis=1, keepdims=True)).max() < 0.1
    for seed in range(5):
        narrow = channels([0.5], [0.005], [[1.0, 2.0]], 1000.0, seed, noise=0.01).values
        assert without_tones(narrow, 0.1)[1].size == 0


def test_a_mode_that_was_found_twice_is_one():
    """The frequency that is known better stays; close modes of other shapes or damping are two."""
    first = (1.0, 0.010, np.array([0.6, 0.8]), 0.002)
    again = (1.002, 0.012, np.array([-0.61, -0.79]) / np.hypot(0.61, 0.79), 0.003)
    assert each_once([again, first]) == [first]
    for other in (
        (1.002, 0.012, np.array([0.8, -0.6]), 0.003),
        (1.01, *again[1:]),
        (1.002, 0.06, *again[2:]),
    ):
        assert each_once([other, first]) == [first, other]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_every_mode_is_found_once(seed):
    """One record of each kind of `benchmarks.coverage.modes`: nothing missed, nothing too many."""
    found = modes.outcome(modes.KINDS[seed], seed)
    assert (found.missed, found.too_many) == (0, 0)
    assert (np.abs(found.deviations) < 4.5).all()


def test_proposed_bands_hold_the_modes():
    building = pmf.SpringMassChain(np.ones(4), 900.0, pmf.ModalDamping(0.01))
    rng, dt = np.random.default_rng(9), 0.04
    wind = pmf.Loading(rng.standard_normal((4, 24_000)), dt, kind="force")
    floors = pmf.simulate(pmf.LinearStructure(**building.matrices()._asdict()), wind, sensors=[1, 3])
    floors = floors + 0.02 * rng.standard_normal(floors.shape)
    exact = building.modes().natural_frequencies
    bands = pmf.ambient.propose_bands(floors)
    for f in exact:
        assert ((bands[:, 0] < f) & (f < bands[:, 1])).any()
    found = pmf.identify_modes(floors)
    np.testing.assert_allclose(found.frequencies, exact, rtol=0.01)
    assert (np.abs(found.frequencies - exact) < 4.5 * found.frequency_sd).all()


def test_bands_do_not_begin_in_the_drift():
    """A mode at 0.1 Hz beside a random walk; without it the band begins far lower."""
    measured = channels([0.1], [0.01], [[1.0, 2.0]], 3000.0, 3, dt=1.0, noise=0.01)
    walk = np.cumsum(np.random.default_rng(2).standard_normal(measured.shape), axis=1)
    drifting = measured + 0.1 * float(measured.std()) * walk
    [quiet], [band] = pmf.ambient.propose_bands(measured), pmf.ambient.propose_bands(drifting)
    assert quiet[0] < band[0] < 0.1 < band[1]
    found = pmf.identify_modes(drifting)
    assert found.frequencies.size == 1 and abs(found.frequencies - 0.1) < 4.0 * found.frequency_sd


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"n_modes": 0}, "`n_modes` must be an integer of at least 1, got 0"),
        ({"n_modes": [1, 1]}, "`n_modes` must be one number for each of the 1 bands, got .1, 1."),
        ({"quantity": "strain"}, "`quantity` must be one of acceleration, velocity, displacement"),
        ({"bands": [1.1, 0.9]}, "`bands` must be ascending pairs between 0 and 5 Hz"),
    ],
)
def test_bad_arguments(arguments, match):
    measured = channels([1.0], [0.02], [[1.0, 2.0]], 100.0, 1)
    with pytest.raises(ValueError, match=match):
        pmf.identify_modes(measured, **{"bands": [0.9, 1.1]} | arguments)


def test_what_comes_in_from_other_modes_is_none():
    """Hardly any noise: in each band the tails of three other modes show, and they are not named."""
    rng, fine = np.random.default_rng(3), 0.005
    building = pmf.SpringMassChain(np.full(4, 1e5), 1e8 * np.ones(4), pmf.ModalDamping(0.015))
    wind = pmf.Loading(rng.standard_normal((4, 80_000)), fine, kind="force")
    whole = pmf.LinearStructure(**building.matrices()._asdict())
    channels = pmf.simulate(whole, wind, sensors=[0, 1, 3])[:, ::4]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = pmf.identify_modes(channels)
    exact = building.modes().natural_frequencies
    assert len(found) == 4 and (abs(found.frequencies - exact) < 5.0 * found.frequency_sd).all()
    with pytest.warns(AmbientWarning, match="lies at the edge of its band"):
        assert len(pmf.identify_modes(channels, [[1.735, 1.95]], n_modes=1)) == 1


def test_a_machine_that_hardly_shows_is_no_mode_either():
    """Too low to be taken off: as narrow as a single frequency, and left out unless `n_modes` says so."""
    measured = channels([2.0], [0.01], [[1.0, 2.0]], 600.0, 8, noise=0.1)
    measured = measured + 0.03 * np.sin(2.0 * np.pi * 1.0003 * measured["time"])
    bands = [[0.9, 1.1], [1.8, 2.2]]
    match = "the mode at 0.9998 Hz is no wider .*a longer record"
    with pytest.warns(AmbientWarning, match=match + ". It is left out; say by `n_modes` that it is one.$"):
        assert pmf.identify_modes(measured, bands).frequencies.size == 1
    noise = 0.1 * np.random.default_rng(1).standard_normal(measured.shape)
    alone = measured.copy(data=noise + 0.014 * np.sin(2.0 * np.pi * 1.0003 * measured["time"].values))
    with pytest.warns(AmbientWarning, match="no wider .* take a longer record.$"):
        assert pmf.identify_modes(alone, bands[0], n_modes=1).frequencies.size == 1
