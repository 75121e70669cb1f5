"""Models and samplers over UM-Bridge: protocol 1.0, values, gradients, a posterior like the direct one."""

import socket
import subprocess
import sys
import time

import numpy as np
import pymc as pm
import pytest
import requests

import pymc_features as pmf
from pymc_features.external.umbridge import RemoteModel, from_umbridge, models_of
from support.external_models import AtOnce

pytestmark = pytest.mark.processes
SERVER = """
import sys
from test_umbridge_model import declare
from pymc_features.external.umbridge import serve

model, mu = declare()
serve(model, response=mu, port=int(sys.argv[1]), compile_kwargs={"mode": "FAST_COMPILE"})
"""
MODEL = '''
import numpy as np
import pymc as pm
import pymc_features as pmf

RECORD = pmf.synthetic_earthquake(duration=5.0, dt=0.02, random_seed=1)


def declare():
    """Two floors; the response and the model."""
    with pm.Model() as model:
        k = pm.LogNormal("k", np.log(300.0), 0.3, shape=2)
        sigma = pm.HalfNormal("sigma", 0.5)
        chain = pmf.SpringMassChain(np.ones(2), k, pmf.ModalDamping(0.02))
        mu = pmf.response(chain, RECORD)
        pmf.ExpFeature("y", mu=mu, sigma=sigma, observed=np.zeros((2, RECORD.n_times)))
    return model, mu
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    (folder / "test_umbridge_model.py").write_text(MODEL)
    (folder / "server.py").write_text(SERVER)
    return folder


@pytest.fixture(scope="module")
def url(folder):
    """Of a server in a process of its own."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([sys.executable, str(folder / "server.py"), str(port)])
    address = f"http://localhost:{port}"
    try:
        for _ in range(1200):
            try:
                requests.get(f"{address}/Info", timeout=20)
                break
            except requests.exceptions.RequestException:
                assert process.poll() is None, "the server ended"
                time.sleep(0.1)
        yield address
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def model(folder):
    """The same model, in this process."""
    names = {}
    exec(MODEL, names)
    return names["declare"]()


def direct(theta):
    """The response without the bridge."""
    chain = pmf.SpringMassChain(np.ones(2), np.exp(theta[:2]), pmf.ModalDamping(0.02))
    record = pmf.synthetic_earthquake(duration=5.0, dt=0.02, random_seed=1)
    return pmf.simulate(chain, record).values


def ask(url, what, **content):
    """Status and answer."""
    answer = requests.post(f"{url}/{what}", json=content, timeout=60)
    return answer.status_code, answer.json()


def test_the_protocol(url):
    info = requests.get(f"{url}/Info", timeout=60).json()
    assert info == {"protocolVersion": 1.0, "models": ["posterior", "response"]}
    n = pmf.synthetic_earthquake(duration=5.0, dt=0.02, random_seed=1).n_times
    for name, size in (("posterior", 1), ("response", 2 * n)):
        _, support = ask(url, "ModelInfo", name=name)
        assert support["support"]["Evaluate"] and support["support"]["Gradient"]
        assert not support["support"]["ApplyJacobian"] and not support["support"]["ApplyHessian"]
        assert ask(url, "InputSizes", name=name, config={}) == (200, {"inputSizes": [3]})
        assert ask(url, "OutputSizes", name=name, config={}) == (200, {"outputSizes": [size]})
        status, answer = ask(url, "Evaluate", name=name, input=[[5.7, 5.8, -1.0]], config={})
        assert status == 200 and len(answer["output"]) == 1 and len(answer["output"][0]) == size
    for what, content, error in (
        ("Evaluate", {"name": "nothing", "input": [[0.0] * 3]}, "ModelNotFound"),
        ("Evaluate", {"name": "posterior", "input": [[0.0] * 4]}, "InvalidInput"),
        (
            "Gradient",
            {"name": "posterior", "outWrt": 0, "inWrt": 1, "input": [[0.0] * 3], "sens": [1]},
            "InvalidInput",
        ),
        (
            "Gradient",
            {"name": "posterior", "outWrt": 1, "inWrt": 0, "input": [[0.0] * 3], "sens": [1]},
            "InvalidInput",
        ),
        ("ApplyJacobian", {"name": "posterior"}, "UnsupportedFeature"),
    ):
        status, answer = ask(url, what, **content)
        assert status == 400 and answer["error"]["type"] == error
    for what, more in (("Evaluate", {}), ("Gradient", {"outWrt": 0, "inWrt": 0, "sens": [1.0] * 2 * n})):
        status, answer = ask(url, what, name="response", input=[[800.0, 0.0, 0.0]], config={}, **more)
        assert status == 500 and answer["error"]["type"] == "InvalidOutput"


def test_densities_responses_and_gradients(url, model):
    declared, _ = model
    density, theta = pmf.compiled_logp(declared), np.array([5.65, 5.8, -1.2])
    given = {"name": "posterior", "input": [theta.tolist()]}
    _, answer = ask(url, "Evaluate", **given)
    assert answer["output"][0][0] == pytest.approx(density.log_posterior(theta), rel=1e-12)
    _, answer = ask(url, "Gradient", **given, outWrt=0, inWrt=0, sens=[2.0])
    np.testing.assert_allclose(answer["output"], 2.0 * density(theta, gradient=True).gradient, rtol=1e-9)
    _, answer = ask(url, "Evaluate", name="posterior", input=[[1e4, 0.0, 0.0]])
    assert answer["output"] == [[-1e300]]  # no stiffness has this logarithm
    _, answer = ask(url, "Evaluate", name="response", input=[theta.tolist()])
    np.testing.assert_allclose(answer["output"][0], direct(theta).ravel(), rtol=1e-10)


def test_a_posterior_over_the_bridge_is_the_direct_one(url):
    """The same draws from the same seed; the gradient comes over the bridge, too."""
    floors = direct(np.array([5.7, 5.75])) + 0.05
    with (
        from_umbridge(url, "response", shape=floors.shape, executor=1) as bridge,
        pmf.ExternalSimulator(direct, shape=floors.shape, executor=1) as here,
    ):
        draws = {}
        for name, simulator in (("bridge", bridge), ("here", here)):
            with pm.Model() as declared:
                theta = pm.Normal("theta", [5.7, 5.7, 0.0], [0.3, 0.3, 1.0])
                pmf.ExpFeature("y", mu=simulator(theta), sigma=0.3, observed=floors)
                draws[name] = pmf.sample_smc(
                    20, stage_draws=20, chains=1, random_seed=1, progressbar=False, cores=1
                )["posterior"]["theta"].values
            if name == "bridge":
                point = {"theta": np.array([5.6, 5.8, 0.3])}
                logp, slope = declared.compile_logp(), declared.compile_dlogp()(point)
                for i, step in enumerate(1e-5 * np.eye(3)[:2]):
                    up, down = (logp({"theta": point["theta"] + sign * step}) for sign in (1, -1))
                    assert slope[i] == pytest.approx((up - down) / 2e-5, rel=1e-5)
        np.testing.assert_allclose(draws["bridge"], draws["here"], rtol=1e-9)
        assert bridge.counts["error"] == 0


def test_bad_addresses_models_and_parameters(url):
    with pytest.raises(ValueError, match="`parameters` must have the 3 entries of the inputs of response, "):
        RemoteModel(url, "response", (2, 251), {})(np.zeros(2))
    with pytest.raises(ConnectionError, match="must be that of a running UM-Bridge server"):
        from_umbridge("http://localhost:9", "forward")
    with pytest.raises(ValueError, match="`url` must be an address as http://localhost:4242, got 'local"):
        from_umbridge("localhost", "forward")
    with pytest.raises(ValueError, match="`model` must be one of posterior, response, got 'forward'"):
        from_umbridge(url, "forward")
    with pytest.raises(ValueError, match="`shape` must be two numbers with the product"):
        from_umbridge(url, "response", shape=(2, 3))


def test_without_a_gradient_none_is_offered():
    """An external function has none."""

    def flat(k):
        return np.full((1, 3), k)

    with pmf.ExternalSimulator(flat, shape=(1, 3), executor=AtOnce(flat), version="1") as simulator:
        with pm.Model() as declared:
            mu = simulator(pm.Normal("k"))
            pm.Normal("y", mu=mu, sigma=1.0, observed=np.zeros((1, 3)))
        posterior, response = models_of(declared, mu, {"mode": "FAST_COMPILE"})
        assert not posterior.supports_gradient() and not response.supports_gradient()
        assert response([[2.0]]) == [[2.0, 2.0, 2.0]]
    with pytest.raises(TypeError, match="`response` must be a variable of the model"):
        models_of(declared, 3.0, None)
