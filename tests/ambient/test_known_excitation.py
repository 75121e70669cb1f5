"""AmbientResponse beside a known excitation: earthquakes with wind, hammers, and what is refused."""

import numpy as np
import pymc as pm
import pytest
from scipy.optimize import minimize

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.frequency_response import blow

BANDS = [(1.63, 2.2), (4.7, 6.3)]
DENSITY = 0.1  # N^2/Hz
RATE, DURATION = 50.0, 400.0
FLOORS = truth.chain_matrices(np.ones(4), np.full(4, 1200.0), (0.5, 0.002))


def frame(k, zeta):
    """Four storeys; modes below 7 Hz have 3.3 and 4.2 %."""
    return pmf.SpringMassChain(np.ones(4), k, pmf.RayleighDamping(0.5 * zeta, 0.002 * zeta))


def storeys(seed, is_known=True):
    """A model of floors that an earthquake and wind move, by transfer functions of modes; 2 % noise."""
    motion = truth.motion(RATE, DURATION, seed)
    wind = truth.motion(RATE, DURATION, 2000 + seed, n_inputs=4, rolloff=1e6, ends="moving")
    lines = np.abs(wind.coefficients) ** 2 * wind.n_period / (2.0 * RATE)  # density in (1 m/s^2)^2/Hz
    density = np.mean(lines[:, 200:800], axis=1, keepdims=True)
    wind = wind._replace(coefficients=wind.coefficients * np.sqrt(DENSITY / density))
    floors = truth.response(FLOORS, motion)["absolute_acceleration"]
    error = 0.02 * floors.std()
    floors += truth.response(FLOORS._replace(places=np.eye(4)), wind)["absolute_acceleration"]
    floors += error * np.random.default_rng(1000 + seed).standard_normal(floors.shape)
    with pm.Model() as model:
        k, zeta = pm.LogNormal("k", np.log(1200.0), 0.1), pm.LogNormal("zeta", 0.0, 0.5)
        response = pmf.ambient.spectral_response(frame(k, zeta), DENSITY)
        pmf.AmbientResponse(
            "y",
            response,
            error=2.0 * error**2 / RATE,
            bands=BANDS,
            dt=1.0 / RATE,
            observed=floors,
            excitation=pmf.Record(motion.values()[0], 1.0 / RATE) if is_known else None,
        )
    return model


def estimated(model, start):
    """Maximum (2,) of the posterior of ln k, ln zeta, and their standard deviations."""
    logp = model.compile_logp()
    names = [v.name for v in model.value_vars]

    def value(x):
        return -logp(dict(zip(names, x, strict=True)))

    found = minimize(value, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6}).x
    h = np.array([1e-4, 1e-2])
    hessian = np.array(
        [
            [
                sum(s * t * value(found + s * a + t * b) for s in (1, -1) for t in (1, -1)) / 4.0
                for b in np.diag(h)
            ]
            for a in np.diag(h)
        ]
    ) / np.outer(h, h)
    return found, np.sqrt(np.diag(np.linalg.inv(hessian)))


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.filterwarnings("ignore::pymc_features.exceptions.AmbientWarning")
def test_an_earthquake_and_wind():
    """Two records within 4 sds (false alarms 3e-4). Control: nobody knows the earthquake."""
    expected = np.array([np.log(1200.0), 0.0])
    for seed in (1, 2):
        found, sd = estimated(storeys(seed), expected)
        assert np.all(np.abs(found - expected) < 4.0 * sd)
    found, sd = estimated(storeys(1, is_known=False), expected)
    assert np.any(np.abs(found - expected) > 4.0 * sd)


def hammer_test(seed, rate=512.0, n=4096, blows=5, ratio=0.01):
    """Force (1, blow, time) and accelerations (1, blow, sensor, time) of three masses; 1 % noise."""
    rng, t = np.random.default_rng(seed), np.arange(n) / rate
    squares, shapes = np.linalg.eigh(1e4 * STIFFNESS)
    pole = np.sqrt(squares) * (-ratio + 1j * np.sqrt(1.0 - ratio**2))
    rings, force, y = np.exp(np.outer(pole, t)), np.zeros((1, blows, n)), np.zeros((1, blows, 3, n))
    for j in range(blows):
        start, length = rng.uniform(0.1, 0.2), rng.uniform(0.015, 0.02)
        force[0, j], follows = blow(t, start, length, 1.0, pole, rings)
        y[0, j] = (shapes * shapes[2]) @ follows.imag
    level = 0.01 * y.std()
    return force, y + level * rng.standard_normal(y.shape), level


STIFFNESS = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


@pytest.mark.slow
def test_blows_say_the_same_as_their_response_functions():
    """One posterior of stiffness and damping from channels and from H1."""
    rate = 512.0
    force, y, level = hammer_test(1, rate)
    measured = pmf.signals.frequency_response(force, y, dt=1.0 / rate, band=(3.0, 40.0))
    results = []
    for way in ("functions", "channels"):
        with pm.Model() as model:
            k, zeta = pm.LogNormal("k", np.log(1e4), 0.1), pm.LogNormal("zeta", np.log(0.01), 0.5)
            parts = {"stiffness_terms": [STIFFNESS], "theta": [k], "damping": pmf.ModalDamping(zeta)}
            masses = pmf.AffineStructure(np.eye(3), stiffness=np.zeros((3, 3)), **parts)
            if way == "functions":
                pmf.FrequencyResponse(
                    "H", masses, observed=measured, responses=[0, 1, 2], references=[2], model_error=None
                )
            else:
                response = pmf.ambient.spectral_response(masses, None)
                for j in range(force.shape[1]):
                    acted = np.zeros((3, force.shape[-1]))
                    acted[2] = force[0, j]
                    pmf.AmbientResponse(
                        f"y{j}",
                        response,
                        error=2.0 * level**2 / rate,
                        bands=[(3.0, 40.0)],
                        dt=1.0 / rate,
                        observed=y[0, j],
                        excitation=pmf.Loading(acted, 1.0 / rate, kind="force"),
                    )
        results.append(estimated(model, np.array([np.log(1e4), np.log(0.01)])))
    (one, sd), (other, other_sd) = results
    assert np.all((other_sd / sd > 0.5) & (other_sd < 1.2 * sd))  # H1 leaves sensitivities 1 % free
    assert np.all(np.abs(one - other) < np.maximum(sd, other_sd))
    assert np.all(np.abs(other - [np.log(1e4), np.log(0.01)]) < 4.0 * other_sd)


def test_what_an_excitation_must_be():
    """One of `excitation` and `mu`, of the length and step of the channels; and the same as `mu`."""
    chain = pmf.SpringMassChain([1.0], 100.0, pmf.ModalDamping(0.05))
    rng = np.random.default_rng(2)
    record, data = pmf.Record(rng.normal(size=400), 0.05), rng.normal(size=(1, 400))
    settings = {"error": 0.1, "bands": [1.0, 2.0], "dt": 0.05, "observed": data}
    values = []
    for known in ({"excitation": record}, {"mu": pmf.response(chain, record)}):
        with pm.Model() as model:
            pmf.AmbientResponse("y", pmf.ambient.spectral_response(chain, 1.0), **settings, **known)
        values.append(model.compile_fn(model.datalogp, mode="FAST_COMPILE")({}))
    np.testing.assert_allclose(*values, rtol=1e-12)
    for known, error, says in (
        ({"excitation": record, "mu": data}, ValueError, "`mu` must be left out with `excitation`"),
        ({"excitation": data}, TypeError, "`excitation` must be a Record or a Loading"),
        ({"excitation": record.first(300)}, ValueError, "`excitation` must be 400 samples at 0.05 s"),
    ):
        with pm.Model(), pytest.raises(error, match=says):
            pmf.AmbientResponse("y", pmf.ambient.spectral_response(chain, 1.0), **settings, **known)
