"""`AmbientResponse`: against covariance matrices, a Gaussian process of the histories, and differences."""

import warnings

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from scipy.linalg import solve_triangular, toeplitz

import pymc_features as pmf
from pymc_features.simulators.spectra import Lines, SpectralParameters, spectral_gradient, spectral_logp
from pymc_features.smc import population_logp

M, S, R, B, K = 3, 5, 4, 2, 40
STARTS = np.array([0, 16, 40])
F = np.concatenate([np.linspace(0.8, 1.2, 16), np.linspace(2.0, 3.0, 24)])
WEIGHTS = np.ones(K)
WEIGHTS[[14, 15, 37, 38, 39]] = 0.0


def random_parameters(rng, n):
    """Parameters of n structures, modes inside the bands."""
    return SpectralParameters(
        rng.uniform(0.9, 2.8, (n, M)),
        rng.uniform(0.01, 0.05, (n, M)),
        rng.normal(size=(n, M, S)),
        rng.normal(size=(n, B, M, R, 2)),
        rng.uniform(0.1, 1.0, (n, B, S)),
        rng.normal(size=(n, S, 2, K)) * WEIGHTS,
    )


def dense_logp(parameters, integrals):
    """Log-likelihood of one structure by its covariance matrices."""
    natural, ratios, shapes, factor, error, spectra = parameters
    logp = 0.0
    for k in np.flatnonzero(WEIGHTS):
        b = np.searchsorted(STARTS, k, side="right") - 1
        beta = natural / F[k]
        h = (2j * np.pi * F[k]) ** -integrals / (1.0 - beta**2 - 2j * ratios * beta)
        root = shapes.T @ np.diag(h) @ (factor[b, ..., 0] + 1j * factor[b, ..., 1])
        covariance = root @ root.conj().T + np.diag(error[b])
        x = spectra[:, 0, k] + 1j * spectra[:, 1, k]
        logp -= S * np.log(np.pi) + np.linalg.slogdet(covariance)[1]
        logp -= (x.conj() @ np.linalg.solve(covariance, x)).real
    return logp


@pytest.mark.parametrize("integrals", [0, 1, 2])
def test_value_and_gradient_against_covariance_matrices(integrals):
    parameters = random_parameters(np.random.default_rng(integrals), 2)
    lines = Lines(F, WEIGHTS, (2.0 * np.pi * F) ** -integrals, STARTS)
    value, with_gradient = np.empty(2), np.empty(2)
    spectral_logp(parameters, lines, value)
    slopes = SpectralParameters(*(np.zeros_like(x) for x in parameters))
    spectral_gradient(parameters, lines, with_gradient, slopes)
    exact = [dense_logp(SpectralParameters(*(x[i] for x in parameters)), integrals) for i in range(2)]
    np.testing.assert_allclose(value, exact, rtol=1e-11)
    np.testing.assert_allclose(with_gradient, exact, rtol=1e-11)
    rng, h = np.random.default_rng(1), 1e-5
    for name, slope in slopes._asdict().items():
        direction = rng.normal(size=slope.shape)
        if name == "spectra":
            direction *= WEIGHTS
        up, down = (
            parameters._replace(**{name: getattr(parameters, name) * (1.0 + sign * h * direction)})
            for sign in (1.0, -1.0)
        )
        ends = (dense_logp(SpectralParameters(*(x[1] for x in moved)), integrals) for moved in (up, down))
        difference = np.subtract(*ends)
        found = np.sum(slope[1] * direction[1] * getattr(parameters, name)[1])
        np.testing.assert_allclose(found, difference / (2.0 * h), rtol=1e-5, err_msg=name)


def test_impossible_parameters_are_minus_infinity_without_gradient():
    parameters = random_parameters(np.random.default_rng(0), 4)
    parameters.natural[0, 1] = np.nan
    parameters.ratios[1, 0] = -0.1
    parameters.error[2, 0, 0] = 0.0
    logp, lines = np.empty(4), Lines(F, WEIGHTS, np.ones(K), STARTS)
    slopes = SpectralParameters(*(np.zeros_like(x) for x in parameters))
    spectral_gradient(parameters, lines, logp, slopes)
    assert np.isneginf(logp[:3]).all() and np.isfinite(logp[3])
    for slope in slopes:
        assert not slope[:3].any() and slope[3].any()


N = 2400


def oscillator(frequency, ratio=0.03):
    """One mass of 2 kg."""
    stiffness = 2.0 * (2.0 * np.pi * frequency) ** 2
    return pmf.SpringMassChain(mass=[2.0], stiffness=stiffness, damping=pmf.ModalDamping(ratio))


def process_logp(y, dt, frequency, ratio, density, error):
    """Log-density of displacements (n,) under a white force, with white errors; or draws, from a generator.

    Crandall & Mark, Random Vibration in Mechanical Systems, 1963: the autocorrelation under a two-sided
    spectral density S_0 in rad/s, here density / (4 pi) / mass^2.
    """
    omega, tau = 2.0 * np.pi * frequency, dt * np.arange(N)
    damped = omega * np.sqrt(1.0 - ratio**2)
    variance = np.pi * density / (4.0 * np.pi) / 4.0 / (2.0 * ratio * omega**3)
    row = variance * np.exp(-ratio * omega * tau)
    row *= np.cos(damped * tau) + ratio * omega / damped * np.sin(damped * tau)
    row[0] += error / (2.0 * dt)  # one-sided density up to half the sampling rate
    factor = np.linalg.cholesky(toeplitz(row))
    if isinstance(y, np.random.Generator):
        return factor @ y.standard_normal(N)
    white = solve_triangular(factor, y, lower=True)
    return -0.5 * N * np.log(2.0 * np.pi) - np.log(np.diag(factor)).sum() - 0.5 * white @ white


def one_oscillator(y, dt, band):
    """A model of displacements (time,) of one oscillator."""
    with pm.Model() as model, warnings.catch_warnings():
        warnings.simplefilter("ignore", pmf.exceptions.AmbientWarning)
        f = pm.Flat("frequency")
        ratio, density, error = pm.Flat("ratio"), pm.Flat("density"), pm.Flat("error")
        response = pmf.ambient.spectral_response(oscillator(f, ratio), density, quantity="displacement")
        pmf.AmbientResponse("y", response, error=error, bands=band, dt=dt, observed=[y])
    return model


def test_log_likelihood_differences_are_those_of_the_gaussian_process():
    """A record of 240 s; the half-power width of the peak holds 29 frequencies. Differences to 1.5 %.

    With a tenth of the error they are those to 5 %: what leaks from the peak is no longer hidden by it.
    """
    dt, truth = 0.1, {"frequency": 2.0, "ratio": 0.03, "density": 4.0, "error": 1e-3}
    y = process_logp(np.random.default_rng(3), dt, **truth)
    exact_truth = process_logp(y, dt, **truth)
    model = one_oscillator(y, dt, [0.004, 4.997])
    logp = model.compile_fn(model.datalogp)
    others = [{"frequency": 1.85}, {"ratio": 0.06}, {"density": 8.0}, {"error": 2e-3}]
    found_truth = logp(truth)
    for other in others:
        expected = exact_truth - process_logp(y, dt, **truth | other)
        found = found_truth - logp(truth | other)
        np.testing.assert_allclose(found, expected, rtol=0.015, err_msg=str(other))


def test_draws_have_the_spectral_density_of_the_model():
    """Mean periodograms of 80 draws over some 40 frequencies: 3000 exponential numbers, within 4.5 s.e.

    In the lowest band there is hardly more than the error.
    """
    density, error, dt, n, bands = 3.0, 0.2, 0.05, 1600, [[0.05, 0.5], [1.0, 1.5], [3.0, 4.0]]
    with pm.Model() as model:
        chain = pmf.SpringMassChain(mass=[1.0, 2.0], stiffness=[300.0, 200.0], damping=pmf.ModalDamping(0.05))
        pm.Normal("unused")
        pmf.AmbientResponse(
            "y",
            pmf.ambient.spectral_response(chain, density),
            error=error,
            bands=bands,
            dt=dt,
            observed=np.zeros((2, n)),
        )
        draws = pm.draw(model["y"], 80, random_seed=1)
    frequencies = np.fft.rfftfreq(n, dt)
    power = np.abs(np.fft.rfft(draws)) ** 2 * (2.0 * dt / n)
    for low, high in bands:
        inside = (frequencies >= low) & (frequencies <= high)
        expected = np.mean([accelerance(chain, f, density) for f in frequencies[inside]], axis=0) + error
        found = power[..., inside].mean(axis=(0, 2))
        scatter = expected / np.sqrt(80 * inside.sum()) * 1.5  # densities differ over the band
        assert (np.abs(found - expected) < 4.5 * scatter).all()
    outside = (frequencies > 1.6) & (frequencies < 2.9)
    assert power[..., outside].max() < 1e-20


def accelerance(chain, f, density):
    """Spectral densities (n,) of accelerations under a force on each mass, from M, C and K."""
    modes, omega = chain.modes(), 2.0 * np.pi * f
    phi, natural = modes.mode_shapes, modes.angular_frequencies
    mass = np.linalg.inv(phi @ phi.T)
    stiffness = mass @ phi @ np.diag(natural**2) @ phi.T @ mass
    damping = mass @ phi @ np.diag(2.0 * modes.damping_ratios * natural) @ phi.T @ mass
    h = -(omega**2) * np.linalg.inv(stiffness - omega**2 * mass + 1j * omega * damping)
    return density * (np.abs(h) ** 2).sum(axis=1)


def three_storeys(kind):
    """A model with forces of that kind, its population and gradient; three sensors of four storeys."""
    rng = np.random.default_rng(4)
    record = pmf.Record(rng.normal(size=800), 0.05)
    forces = {"dofs": "dofs", "modes": "modes", "pattern": np.array([[1.0, 0, 0, 0], [0, 1, 1, 1]]).T}[kind]
    with pm.Model() as model:
        k = pm.LogNormal("k", np.log(400.0), 0.1, shape=4)
        density = pm.LogNormal("density", 0.0, 0.5, shape=2)
        error = pm.LogNormal("error", 0.0, 0.5, shape=(2, 3) if kind == "dofs" else ())
        chain = pmf.SpringMassChain(mass=np.ones(4), stiffness=k, damping=pmf.ModalDamping(0.03))
        response = pmf.ambient.spectral_response(chain, density, forces=forces, sensors=[0, 2, 3], n_modes=3)
        pmf.AmbientResponse(
            "y",
            response,
            error=error,
            bands=[[0.8, 1.6], [2.0, 4.5]],
            dt=0.05,
            observed=rng.normal(size=(3, 800)),
            mu=pmf.response(chain, record, sensors=[0, 2, 3]) if kind == "pattern" else None,
        )
    return model


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pymc_features.exceptions.AmbientWarning")
@pytest.mark.parametrize("kind", ["dofs", "modes", "pattern"])
def test_gradients_of_populations_through_the_structure(kind):
    """Forces on each storey, on each mode, and in patterns beside a known motion of the base."""
    model = three_storeys(kind)
    logp = population_logp(model, model.initial_point(), {})
    assert logp.batched
    rng = np.random.default_rng(5)
    points = logp.start + 0.1 * rng.normal(size=(3, logp.start.shape[1]))
    prior, likelihood, _, _, slope = logp.gradient(points)
    one_by_one = [logp(x[None])[1][0] for x in points]
    np.testing.assert_allclose(likelihood, one_by_one, rtol=1e-10)
    h = 1e-5
    for i in range(points.shape[1]):
        step = h * np.eye(points.shape[1])[i]
        difference = (logp(points + step)[1] - logp(points - step)[1]) / (2.0 * h)
        np.testing.assert_allclose(slope[:, i], difference, rtol=2e-5, atol=2e-4)


def test_a_known_motion_is_taken_off_the_data():
    """Data with a known part have the likelihood of data without it."""
    rng = np.random.default_rng(6)
    record, y = pmf.Record(rng.normal(size=400), 0.05), rng.normal(size=(1, 400))
    known = pmf.simulate(oscillator(1.5), record).values
    values = []
    for data, mu in ((y, None), (y + known, known)):
        with pm.Model() as model:
            response = pmf.ambient.spectral_response(oscillator(pm.Flat("f")), 1.0)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pmf.exceptions.AmbientWarning)
                pmf.AmbientResponse("y", response, error=0.1, bands=[1.0, 2.0], dt=0.05, observed=data, mu=mu)
        values.append(model.compile_fn(model.datalogp)({"f": 1.4}))
    np.testing.assert_allclose(*values, rtol=1e-9)


GOOD = {"error": 0.1, "bands": [1.0, 2.0], "dt": 0.05, "observed": np.ones((1, 4000))}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"bands": [2.0, 1.0]}, "`bands` must be ascending pairs between 0 and 10 Hz"),
        ({"bands": [1.0, 30.0]}, "half the sampling rate"),
        ({"bands": [[1.0, 2.0], [1.5, 3.0]]}, "`bands` must be apart"),
        ({"bands": [1.0, 1.01]}, "take a longer record, or a wider band"),
        ({"error": -1.0}, "`error` must be positive"),
        ({"error": [1.0, 2.0]}, "`error` must be one value, one for each of the 1 bands"),
        ({"observed": np.ones((2, 4000))}, r"`observed` must be \(1, time\), a row for each sensor"),
        ({"observed": np.full((1, 4000), np.nan)}, "Cut the record where there are gaps"),
        ({"mu": np.ones(3)}, "`mu` must be of shape"),
    ],
)
def test_bad_input_is_refused(change, says):
    with pm.Model(), pytest.raises(ValueError, match=says):
        pmf.AmbientResponse("y", pmf.ambient.spectral_response(oscillator(1.5), 1.0), **GOOD | change)


@pytest.mark.parametrize(
    ("settings", "error", "says"),
    [
        ({"excitation": -1.0}, ValueError, "`excitation` must be positive"),
        ({"forces": "wind"}, ValueError, "`forces` must be"),
        ({"forces": np.ones((2, 1))}, ValueError, r"`forces` must be \(1, force\)"),
        ({"quantity": "strain"}, ValueError, "`quantity` must be"),
        ({"sensors": [0], "outputs": np.ones((1, 1))}, ValueError, "`sensors` must be left out"),
    ],
)
def test_bad_responses_are_refused(settings, error, says):
    with pytest.raises(error, match=says):
        pmf.ambient.spectral_response(oscillator(1.5), **{"excitation": 1.0} | settings)


def test_what_says_little_is_told():
    with pm.Model():
        response = pmf.ambient.spectral_response(oscillator(1.5, ratio=pt.constant(0.001)), 1.0)
        with pytest.warns(match="short for the mode of y at 1.5 Hz with 0.1 % damping") as warned:
            pmf.AmbientResponse("y", response, **GOOD)
        assert [w.category for w in warned] == [pmf.exceptions.AmbientWarning]
        error = pm.HalfNormal("error")  # of which the modes do not depend
        with pytest.warns(match="band 3 to 4 Hz of z has no mode .* nearest is at 1.5"):
            pmf.AmbientResponse("z", response, **GOOD | {"bands": [3.0, 4.0], "error": error})


def test_histories_of_no_model():
    """`dist` has the draws and the log-density of the variable of a model."""
    response = pmf.ambient.spectral_response(oscillator(2.0), 4.0)
    settings = {"error": 1e-2, "bands": [1.0, 3.0], "dt": 0.1}
    free = pmf.AmbientResponse.dist(response, n_samples=2000, **settings)
    values = pm.draw(free, random_seed=1)
    assert values.shape == (1, 2000) and values.std() > 0.1
    with pm.Model() as model:
        pmf.AmbientResponse("y", response, observed=values, **settings)
    assert pm.logp(free, values).eval() == pytest.approx(model.compile_fn(model.datalogp)({}), rel=1e-12)
    with pytest.raises(ValueError, match="`n_samples` must be"):
        pmf.AmbientResponse.dist(response, n_samples=0, **settings)
