"""FrequencyResponse: modes of measured response functions against closed forms, and what intervals hold."""

import warnings

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from pytensor.graph.replace import vectorize_graph
from scipy.linalg import eigh

import pymc_features as pmf
from benchmarks.coverage.frequency_response import BAND, beam, hammer_test, one, responses
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.frequency_response import FrequencyResponse, measured_modes, standardised

MASS, SPRINGS, RATIO = np.array([1.0, 1.2, 0.8]), np.array([900.0, 800.0, 700.0]), 0.01
POINTS, SENSORS = [0, 2], [1, 2]
F = np.linspace(1.0, 9.5, 1200)  # Hz; the three modes are at 1.9, 5.3 and 7.8


def matrices(springs=SPRINGS):
    """Mass and stiffness of a chain."""
    stiffness = (
        np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    )
    return np.diag(MASS), stiffness


def exact(springs=SPRINGS, f=F, power=2):
    """Response functions (sensor, point, line) by inverting the dynamic stiffness."""
    mass, stiffness = matrices(springs)
    squares, shapes = eigh(stiffness, mass)
    damping = mass @ shapes @ np.diag(2.0 * RATIO * np.sqrt(squares)) @ shapes.T @ mass
    s = 2j * np.pi * f[:, None, None]
    inverse = np.linalg.inv(s**2 * mass + s * damping + stiffness)
    return (s**power * inverse)[:, SENSORS][:, :, POINTS].transpose(1, 2, 0)


def dataset(h, variance=None, **attrs):
    """Response functions as readers give them."""
    dims = "response", "reference", "frequency"
    variables = {"frequency_response": (dims, h)}
    if variance is not None:
        variables["variance"] = (dims, np.broadcast_to(variance, h.shape))
    coords = {"response": ["2", "3"], "reference": ["1", "3"], "frequency": F}
    return xr.Dataset(variables, coords, {"quantity": "accelerance", "excitation": "force"} | attrs)


def measured(level=0.003, seed=1, springs=SPRINGS, **attrs):
    """With errors of one level, and its variance."""
    h, rng = exact(springs), np.random.default_rng(seed)
    level = level * np.sqrt(np.mean(np.abs(h) ** 2))
    noise = rng.standard_normal((2, *h.shape)) * level * np.sqrt(0.5)
    return dataset(h + noise[0] + 1j * noise[1], level**2, **attrs)


def declare(data, **settings):
    """A chain whose lower two springs and damping are sought."""
    with pm.Model() as model:
        theta = pm.LogNormal("theta", 0.0, 0.3, shape=2)
        zeta = pm.LogNormal("zeta", np.log(RATIO), 0.5)
        springs = pm.math.concatenate([theta, [1.0]]) * SPRINGS
        chain = pmf.SpringMassChain(MASS, springs, pmf.ModalDamping(zeta))
        settings = {"responses": SENSORS, "references": POINTS} | settings
        FrequencyResponse("H", chain, observed=data, **settings)
    return model


@pytest.fixture(scope="module")
def data():
    """Response functions with errors of 0.3 %."""
    return measured()


@pytest.fixture(scope="module")
def model(data):
    """The model of them, with errors of modes."""
    return declare(data)


def test_the_modes_that_lines_show():
    """ln w, ln zeta over their standard deviations, 40 fits: as wide as said. Control: half of it is not."""
    squares, shapes = eigh(*matrices()[::-1])
    found = []
    for seed in range(40):
        fit = measured_modes(measured(0.03, seed)).fit  # drifts between points are below that
        assert len(fit.modes.natural) == 3
        sd = np.sqrt(np.diag(fit.covariance)).reshape(3, -1)
        off = np.log([fit.modes.natural / np.sqrt(squares), fit.modes.ratios / RATIO]).T
        found.append(off / sd[:, :2])
        products = fit.modes.outputs[:, :, None] * fit.modes.inputs[:, None]
        expected = shapes[SENSORS].T[:, :, None] * shapes[POINTS].T[:, None]
        np.testing.assert_allclose(products, expected, atol=0.05 * np.abs(expected).max())
    spread = np.std(found)  # of 240 numbers: 0.9 to 1.1 but once in 30, 0.8 to 1.2 but once in 10,000
    assert 0.8 < spread < 1.2 and not 0.8 < 2.0 * spread < 1.2


@pytest.mark.parametrize("power", [0, 1])
def test_mobilities_and_receptances(power):
    """Their modes are those of accelerances."""
    h = exact(power=power)
    kind = {0: "receptance", 1: "mobility"}[power]
    fit = measured_modes(dataset(h, 1e-6 * np.mean(np.abs(h) ** 2), quantity=kind)).fit
    squares, _ = eigh(*matrices()[::-1])
    np.testing.assert_allclose(fit.modes.natural, np.sqrt(squares), rtol=1e-6)
    np.testing.assert_allclose(fit.modes.ratios, RATIO, rtol=1e-4)


def modal(theta, zeta):
    """q (3, 2 + sensors + points) of the chain."""
    squares, shapes = eigh(*matrices(np.append(theta, 1.0) * SPRINGS)[::-1])
    return np.column_stack(
        [0.5 * np.log(squares), np.full(3, np.log(zeta)), shapes[SENSORS].T, shapes[POINTS].T]
    )


def rms(x):
    """Root mean squares of rows (n, 1)."""
    return np.sqrt(np.mean(x**2, axis=1, keepdims=True))


def closed_form(fit, theta, zeta, sigmas):
    """ln N(q_0; q, S + Lambda^-1) up to what is constant, without an inverse of Lambda, which is singular."""
    n_in = len(POINTS)
    table, q = fit.modes.table, modal(theta, zeta)
    order = [0, 1, 2 + n_in, 3 + n_in, 2, 3]
    table, at = table[:, order], (np.arange(3)[:, None] * 6 + order).ravel()
    information = fit.information[np.ix_(at, at)]
    a, b = q[:, 2:4], q[:, 4:]
    scale = np.sqrt(rms(b) * rms(table[:, 2:4]) / (rms(a) * rms(table[:, 4:])))
    a, b = a * scale, b / scale
    sense = np.sign(np.sum(a * table[:, 2:4] + b * table[:, 4:], axis=1, keepdims=True))
    d = (np.column_stack([q[:, :2], sense * a, sense * b]) - table).ravel()
    sizes = np.column_stack(
        [np.ones((3, 2)), *(np.repeat(rms(table[:, i : i + 2]), 2, axis=1) for i in (2, 4))]
    )
    s = np.diag((np.array([sigmas[0], sigmas[1], *[sigmas[2]] * 4]) * sizes).ravel() ** 2)
    f = 6 * np.arange(3)
    s[np.ix_(f, f)] = sigmas[0] ** 2 * (0.6 + 0.4 * np.eye(3))
    a = np.eye(18) + information @ s
    return -0.5 * d @ np.linalg.solve(a, information @ d) - 0.5 * np.linalg.slogdet(a)[1]


def test_log_likelihood_in_closed_form(model, data):
    """Differences between points, to 1e-8 of them; with large and with hardly any errors of the model."""
    fit = measured_modes(data).fit
    logp = model.compile_logp(vars=[model["H"]])
    found, expected = [], []
    for theta, zeta, sigmas in (
        ([1.0, 1.0], 0.01, [0.02, 0.2, 0.1]),
        ([1.1, 0.9], 0.012, [0.02, 0.1, 0.2]),
        ([1.01, 0.99], 0.0101, [1e-4, 1e-3, 1e-3]),
    ):
        values = {"theta_log__": np.log(theta), "zeta_log__": np.log(zeta)}
        values |= {
            f"H_{key}_log__": np.log(x)
            for key, x in zip(("sigma_f", "sigma_zeta", "sigma_phi"), sigmas, strict=True)
        }
        found.append(logp({name: np.asarray(x) for name, x in values.items()}))
        expected.append(closed_form(fit, theta, zeta, sigmas))
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-7)


def test_gradient(model):
    """By differences, by every parameter."""
    point = model.initial_point()
    point["theta_log__"] = np.array([0.05, -0.1])
    logp, slope = model.compile_logp(), model.compile_dlogp()
    expected, names = [], list(point)
    for name in names:
        for i in np.ndindex(np.shape(point[name])):
            ends = []
            for sign in (1e-6, -1e-6):
                moved = {k: np.array(v) for k, v in point.items()}
                moved[name][i] += sign
                ends.append(logp(moved))
            expected.append((ends[0] - ends[1]) / 2e-6)
    np.testing.assert_allclose(slope(point), expected, rtol=1e-5, atol=1e-5)


def test_a_population_is_each_by_itself(model):
    """Values of a batch of parameters."""
    [value] = model.replace_rvs_by_values([model.logp()])
    inputs = model.value_vars
    batch = {x: x.type.clone(shape=(5, *x.type.shape))() for x in inputs}
    many = vectorize_graph(value, batch)
    rng, point = np.random.default_rng(1), model.initial_point()
    rows = {x: point[x.name] + 0.1 * rng.standard_normal((5, *np.shape(point[x.name]))) for x in inputs}
    logp = model.compile_logp()
    expected = [logp({x.name: rows[x][i] for x in inputs}) for i in range(5)]
    np.testing.assert_allclose(many.eval({batch[x]: rows[x] for x in inputs}), expected, rtol=1e-9)


def test_draws_have_the_covariance_of_the_likelihood(model, data):
    """Mean squares of 4,000 draws at fixed parameters within 6 sds; control: without errors of modes."""
    with model:
        fixed = pm.do(
            model,
            {"theta": [1.0, 1.0], "zeta": RATIO, "H_sigma_f": 0.02, "H_sigma_zeta": 0.2, "H_sigma_phi": 0.1},
        )
    with fixed:
        draws = pm.draw(fixed["H"], 4000, random_seed=1)
    _, root, parts, _ = standardised(measured_modes(data).fit, True)
    covariance = np.eye(len(root)) + np.tensordot(np.array([0.02, 0.2, 0.1]) ** 2, parts, 1)
    ratio = draws.var(axis=0) / np.diag(covariance)
    assert np.abs(ratio - 1.0).max() < 6.0 * np.sqrt(2.0 / 4000)
    assert draws.var(axis=0).max() > 100.0


@pytest.mark.statistical
@pytest.mark.slow
def test_resolution_does_not_narrow_the_posterior():
    """It holds the truth, and is as wide, within 15 %, from every fourth line. Control: the lines alone."""
    errors, sds, of_lines = {"sigma_f": 0.005, "sigma_zeta": 0.05, "sigma_phi": 0.02}, [], []
    for every in (1, 4):
        data = measured(0.03).isel(frequency=slice(None, None, every))
        of_lines.append(np.sqrt(measured_modes(data).fit.covariance[0, 0]))
        with declare(data, **errors):
            idata = pmf.sample(draws=300, chains=2, random_seed=1, progressbar=False)
        theta = idata["posterior"]["theta"].values.reshape(-1, 2)
        sds.append(theta.std(axis=0))
        assert np.all(np.abs(theta.mean(axis=0) - 1.0) < 4.0 * sds[-1])
    assert np.max(np.abs(np.log(sds[1] / sds[0]))) < 0.15 < np.log(of_lines[1] / of_lines[0])


@pytest.mark.statistical
@pytest.mark.slow
def test_coverage():
    """Intervals of 6 tests of modes with errors hold 70 % (false alarms 1e-3). Control: lines alone."""
    inside = [one("errors of modes, 2 s", seed)[0] for seed in range(6)]
    assert np.mean(inside) > 0.7
    assert np.mean([one("errors of modes, lines alone", seed)[0] for seed in range(2)]) < 0.4


def test_a_record_that_is_cut():
    """What is cut off a response is in the fit: ln zeta within 5 sds, and beyond without it."""
    test = hammer_test(beam(), np.full(40, 0.01), 1.0, np.random.default_rng(1))
    data = responses(test).sel(frequency=slice(BAND[0], 300.0))
    off = []
    for found in (data, data.assign_coords(blow=("reference", [np.nan] * 3))):
        fit = measured_modes(found).fit
        sd = np.sqrt(np.diag(fit.covariance)).reshape(len(fit.modes.natural), -1)
        off.append(np.abs(np.log(fit.modes.ratios[0] / 0.01) / sd[0, 1]))
    assert off[0] < 5.0 < off[1]


def test_the_sense_of_a_channel(data):
    """A sensor turned round is read by its name, and otherwise changes the shape."""
    turned = data.copy()
    turned["frequency_response"] = data["frequency_response"] * xr.DataArray([-1.0, 1.0], dims="response")
    values = []
    for h, names in ((data, ["2:+x", "3:+x"]), (turned, ["2:-x", "3:+x"]), (turned, ["2:+x", "3:+x"])):
        h = h.assign_coords(response=names, reference=["1:+x", "3:+x"])
        with pm.Model() as model:
            k = pm.LogNormal("k", 0.0, 0.1)
            mass, stiffness = matrices()
            frame = pmf.AffineStructure(
                mass,
                stiffness=0.0 * mass,
                damping=pmf.ModalDamping(RATIO),
                stiffness_terms=[stiffness],
                theta=[k],
            )
            FrequencyResponse("H", frame.with_names(["1:+x", "2:+x", "3:+x"]), observed=h)
        values.append(model.compile_logp()(model.initial_point()))
    assert values[1] == pytest.approx(values[0], rel=1e-6)
    assert values[2] < values[0] - 10.0


def test_motions_of_the_base():
    """Of absolute accelerations under a base: participation is free, frequencies and damping are found."""
    mass, stiffness = matrices()
    squares, shapes = eigh(stiffness, mass)
    s, w = 2j * np.pi * F[:, None], np.sqrt(squares)
    relative = -(shapes.T @ MASS) / (s**2 + 2.0 * RATIO * w * s + squares)
    h = (1.0 + (s**2 * relative) @ shapes[SENSORS].T).T[:, None]
    rng = np.random.default_rng(2)
    h = h + 3e-3 * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    data = dataset(np.repeat(h, 2, axis=1), 1.8e-5, excitation="base").isel(reference=[0])
    model = declare(data, references=None)
    found = pm.find_MAP(model=model, progressbar=False)
    np.testing.assert_allclose(found["theta"], 1.0, atol=0.02)
    assert found["zeta"] == pytest.approx(RATIO, rel=0.1)


@pytest.mark.slow
def test_a_measured_beam(data_dir):
    """Four modes, shapes as those of a free beam of 1.287 m (MAC 0.99), the same from half of the lines."""
    file = data_dir / "hammer_beam" / "frf.npz"
    if not file.is_file():
        pytest.skip("the measured beam is not there")
    with np.load(file) as found:
        f, h = found["frequency"], found["accelerance"]
    x = (np.array([0.1, 0.25, 0.375, 0.5, 0.65, 0.8, 0.925, 1.05, 1.2]) - 0.01) / 1.287
    fits = []
    for every in (8, 16):
        coords = {"response": ["4"], "reference": [str(i) for i in range(9)], "frequency": f[::every]}
        attrs = {"quantity": "accelerance", "excitation": "force"}
        lines = xr.Dataset({"frequency_response": (list(coords), h[None, :, ::every])}, coords, attrs)
        fits.append(measured_modes(lines).fit)
    np.testing.assert_allclose(
        fits[0].modes.natural / (2.0 * np.pi), [111.99, 306.86, 596.37, 974.13], rtol=5e-5
    )
    for b, shape in zip((4.7300407, 7.8532046, 10.9956078, 14.1371655), fits[0].modes.inputs, strict=True):
        ratio = (np.cosh(b) - np.cos(b)) / (np.sinh(b) - np.sin(b))
        free = np.cosh(b * x) + np.cos(b * x) - ratio * (np.sinh(b * x) + np.sin(b * x))
        assert (free @ shape) ** 2 / (free @ free) / (shape @ shape) > 0.99
    sds = [np.sqrt(np.diag(fit.covariance)).reshape(4, -1)[:, 0] for fit in fits]
    np.testing.assert_allclose(sds[1], sds[0], rtol=0.2)
    assert np.all(np.abs(np.log(fits[1].modes.natural / fits[0].modes.natural)) < 2.0 * sds[0])


def test_what_does_not_fit_is_named(data):
    """A peak that the model lacks, one that the band cuts off, residuals that variances do not explain."""
    noisy = measured(0.5).sel(frequency=slice(None, 6.5))
    with pytest.warns(ModalMatchWarning, match="some modes have no peak"), pm.Model():
        k = pm.LogNormal("k", -0.5, 0.1)  # all three below 6.5 Hz
        chain = pmf.SpringMassChain(MASS, k * SPRINGS, pmf.ModalDamping(RATIO))
        FrequencyResponse("H", chain, observed=noisy, responses=SENSORS, references=POINTS)
    cut = data.sel(frequency=slice(None, 7.0))
    with pytest.warns(ModalMatchWarning, match="some peaks have no mode"), pm.Model():
        k = pm.LogNormal("k", 1.5, 0.1)
        chain = pmf.SpringMassChain(MASS, k * SPRINGS, pmf.ModalDamping(RATIO))
        FrequencyResponse("H", chain, observed=cut, responses=SENSORS, references=POINTS)
    wrong = data.assign(variance=data["variance"] * 0.25)
    with pytest.warns(ModalMatchWarning, match="times their variance"):
        declare(wrong, model_error=None)


def test_refusals(data):
    """Each in a sentence."""
    noise = data.copy()
    rng = np.random.default_rng(1)
    noise["frequency_response"] = noise["frequency_response"] * 0.0 + rng.standard_normal(
        data["frequency_response"].shape
    )
    cases = (
        (data["frequency_response"], {}, TypeError, "`observed` must be frequency response functions"),
        (data.where(data["frequency"] > 2.0), {}, ValueError, "finite, at ascending frequencies"),
        (noise, {}, ValueError, "lines with modes"),
        (data, {"responses": None}, ValueError, "`responses` must be given for a structure"),
        (data, {"responses": [1]}, ValueError, "`responses` must be one for each of the 2 channels"),
        (data, {"n_modes": 2}, ValueError, "`n_modes` must be at least 3"),
        (data, {"model_error": "lines"}, ValueError, "`model_error` must be"),
        (data, {"sigma_f": -0.1}, ValueError, "`sigma_f` must be positive"),
    )
    for observed, settings, error, words in cases:
        with pytest.raises(error, match=words):
            declare(observed, **settings)
    with pm.Model(), pytest.raises(ValueError, match="`structure` must be damped in all modes"):
        chain = pmf.SpringMassChain(MASS, SPRINGS, pmf.ModalDamping(0.0))
        FrequencyResponse("H", chain, observed=data, responses=SENSORS, references=POINTS)


def test_short_segments_are_named(data):
    """Hann segments with fewer than three lines in a half-power width, at 1.9 Hz; not longer ones."""
    with pytest.warns(
        ModalMatchWarning, match="Hann segments of 60 s are short .* 2.095 Hz, which will look"
    ):
        declare(data.assign_attrs(window="hann", duration=60.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        declare(data.assign_attrs(window="hann", duration=90.0))
