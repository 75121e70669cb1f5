"""ModalFeature: its density with the assignment inside, continuity where modes cross, draws, posteriors."""

import itertools
import warnings

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from pytensor.graph.replace import vectorize_graph
from pytensor.tensor.blockwise import Blockwise
from scipy import stats

from pymc_features import AffineStructure, ModalDamping, ModalFeature, SpringMassChain, modes, sample
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal import mac
from pymc_features.modal.feature import checked_parameters
from pymc_features.modal.identified import identified
from support.graphs import LIGHT, PLAIN, REWRITTEN

UNDAMPED = ModalDamping(0.0)


def direct(model_modes, data, sigma_f, sigma_phi, m, labels=None):
    """Log-likelihood of each identification by SciPy, and the best of all assignments one by one."""
    frequencies, shapes = model_modes
    n = len(data["frequencies"])
    labels = list(range(n)) if labels is None else list(labels)
    names = sorted(set(labels), key=labels.index)
    sd = np.zeros(n) if data.get("frequency_sd") is None else data["frequency_sd"] / data["frequencies"]
    sd = np.sqrt(sd**2 + np.square(sigma_f))
    density = stats.norm.logpdf(
        np.log(data["frequencies"])[:, None], np.log(frequencies)[None], np.broadcast_to(sd, n)[:, None]
    )
    if data.get("shapes") is not None:
        e = 1.0 - mac(data["shapes"], shapes)
        known = (~np.isnan(data["shapes"])).sum(axis=1) > 1
        e = np.where(known[:, None], e, 1.0)
        s = np.broadcast_to(sigma_phi, n)[:, None]
        # e^(m/2) has this density where e / sigma^2 is chi-square with m degrees of freedom
        of_shape = (
            stats.chi2(m).logpdf(e / s**2) - 2 * np.log(s) - np.log(0.5 * m) - (0.5 * m - 1) * np.log(e)
        )
        density = density + np.where(known[:, None], of_shape, 0.0)
    best = None
    for chosen in itertools.permutations(range(len(frequencies)), len(names)):
        own = np.array([density[i, chosen[names.index(labels[i])]] for i in range(n)])
        best = own if best is None or own.sum() > best.sum() else best
    return best


def log_likelihoods(found, data, **kwargs):
    """Of each identification, as the model has it."""
    with warnings.catch_warnings(), pm.Model() as model:
        warnings.simplefilter("ignore", ModalMatchWarning)
        rv = ModalFeature("y", found, observed=data, **kwargs)
        [logp] = model.logp(vars=[rv], sum=False)
    return logp


def random_data(seed, kind=float, missing=True, n=4, s=5):
    rng = np.random.default_rng(seed)
    frequencies = np.sort(rng.uniform(1.0, 4.0, n + 2))
    shapes = rng.normal(size=(n + 2, s))
    picked = rng.permutation(n + 2)[:n]
    measured = rng.uniform(-3, 3, (n, 1)) * shapes[picked] + 0.3 * rng.normal(size=(n, s))
    if kind is complex:
        measured = measured * np.exp(1j * rng.uniform(0, 6, (n, 1))) + 0.1j * rng.normal(size=(n, s))
    if missing:
        measured[rng.random((n, s)) < 0.25] = np.nan
        measured[1, 1:] = np.nan  # one entry: says nothing
    data = {
        "frequencies": frequencies[picked] * np.exp(0.1 * rng.normal(size=n)),
        "shapes": measured,
        "frequency_sd": rng.uniform(0.01, 0.1, n),
    }
    return (frequencies, shapes), data


@pytest.mark.slow
@pytest.mark.parametrize("density, m", [("TN", 1), ("EXP", 2), (3.5, 3.5)])
@pytest.mark.parametrize("kind", [float, complex])
def test_density_against_scipy_and_all_assignments(kind, density, m):
    found, data = random_data(0, kind)
    logp = log_likelihoods(found, data, sigma_f=0.05, sigma_phi=0.3, density=density).eval(mode=PLAIN)
    expected = direct(found, data, 0.05, 0.3, m)
    np.testing.assert_allclose(logp, expected, rtol=1e-10)


def test_frequencies_alone_and_exact_standard_deviations():
    found, data = random_data(2)
    plain = log_likelihoods(found[:1], data["frequencies"], sigma_f=0.1).eval(mode=PLAIN)
    np.testing.assert_allclose(
        plain, direct(found, {"frequencies": data["frequencies"]}, 0.1, None, 2), rtol=1e-12
    )
    data["shapes"] = None
    with_sd = log_likelihoods(found, data, sigma_f=0.0).eval(mode=PLAIN)
    np.testing.assert_allclose(with_sd, direct(found, data, 0.0, None, 2), rtol=1e-12)


def test_what_is_no_structure_or_no_scale_is_impossible():
    k, sigma = pt.vector("k", shape=(3,)), pt.scalar("sigma")
    chain = SpringMassChain(np.ones(3), k, UNDAMPED)
    data = {"frequencies": [0.7, 2.0], "shapes": np.eye(3)[:2] + 0.3}
    logp = log_likelihoods(modes(chain), data, sigma_f=0.1, sigma_phi=sigma).sum()
    many, sigmas = pt.matrix("many", shape=(None, 3)), pt.vector("sigmas")
    batch = vectorize_graph(logp, {k: many, sigma: sigmas})
    values = np.array([[100.0] * 3, [100.0, -1.0, 100.0]]), np.array([0.2, 0.2])
    got = pytensor.function([many, sigmas], batch, mode=PLAIN)(*values)
    assert np.isfinite(got[0]) and got[1] == -np.inf
    with pytest.raises(Exception, match="sigma_phi > 0"):
        logp.eval({k: [100.0] * 3, sigma: -1.0}, mode=PLAIN)


def test_a_population_is_evaluated_in_one_call():
    x = pt.vector("x", shape=(4,))
    chain = SpringMassChain(np.ones(3), 100.0 * x[:3], UNDAMPED)
    data = {"frequencies": [0.75, 2.1], "shapes": [[0.3, 0.6, 0.8], [-0.7, -0.3, 0.6]]}
    logp = log_likelihoods(modes(chain), data, sigma_f=x[3], sigma_phi=0.2).sum()
    rows = pt.matrix("rows", shape=(None, 4))
    batch = vectorize_graph(logp, {x: rows})
    function = pytensor.function([rows], [batch, pt.grad(batch.sum(), rows)], mode=REWRITTEN)
    ours = [
        n.op for n in function.maker.fgraph.apply_nodes if type(n.op).__module__.startswith("pymc_features")
    ]
    assert len(ours) == 3  # modes, assignment, gradient
    looped = [n.op for n in function.maker.fgraph.apply_nodes if isinstance(n.op, Blockwise)]
    assert all(op.gufunc_spec is not None for op in looped)
    one = pytensor.function([x], [logp, pt.grad(logp, x)], mode=PLAIN)
    points = np.random.default_rng(4).uniform(0.5, 2.0, (6, 4))
    values, slopes = function(points)
    for i, point in enumerate(points):
        value, slope = one(point)
        assert values[i] == pytest.approx(value, rel=1e-12)
        np.testing.assert_allclose(slopes[i], slope, rtol=1e-10, atol=1e-10)
        d = []
        for h in (1e-4, 5e-5):
            d.append([(one(point + h * e)[0] - one(point - h * e)[0]) / (2 * h) for e in np.eye(4)])
        expected = (4 * np.array(d[1]) - np.array(d[0])) / 3
        np.testing.assert_allclose(slope, expected, rtol=1e-7, atol=1e-7 * abs(expected).max())


def column(theta, coupling):
    """A column of two storeys in x and y, theta times as stiff in x; uncoupled they cross at theta = 1."""
    storeys = 100.0 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    zero = np.zeros((2, 2))
    both = np.block([[zero, coupling * np.eye(2)], [coupling * np.eye(2), storeys]])
    return AffineStructure(
        np.ones(4),
        stiffness=both,
        damping=UNDAMPED,
        stiffness_terms=[np.block([[storeys, zero], [zero, zero]])],
        theta=theta,
    )


MEASURED = {  # both directions at once, x a little lower
    "frequencies": np.array([0.96, 1.01]),
    "shapes": np.array([[0.52, 0.85, 0.1, 0.05], [0.1, -0.05, 0.55, 0.83]]),
}


def walk(coupling, n, half_width, fixed=False):
    """Log-likelihood along theta, n steps across the crossing; the modes by their number if `fixed`."""
    theta = pt.vector("theta", shape=(1,))
    found = modes(column(theta, coupling), 4)
    logp = log_likelihoods(found, MEASURED, sigma_f=0.02, sigma_phi=0.2).sum()
    if fixed:
        logp = sum(
            log_likelihoods(
                (found.frequencies[r : r + 1], found.shapes[r : r + 1]),
                {k: v[r : r + 1] for k, v in MEASURED.items()},
                sigma_f=0.02,
                sigma_phi=0.2,
            ).sum()
            for r in range(2)
        )
    function = pytensor.function([theta], logp, mode=PLAIN)
    # never exactly at the crossing, where the shapes of the pair are any of their plane
    return np.array([function([x]) for x in 1.0 + half_width * (np.linspace(-1.0, 1.0, n + 1) + 1e-7)])


@pytest.mark.slow
@pytest.mark.parametrize(
    "coupling, half_width", [(0.0, 0.1), (1e-3, 2e-4)], ids=["crossing", "narrow veering"]
)
def test_density_is_continuous_where_modes_cross(coupling, half_width):
    """The largest step of a walk halves with the step length; of modes by their number it does not."""
    whole = walk(coupling, 200, half_width)
    coarse, fine = (abs(np.diff(values)).max() for values in (whole[::2], whole))
    assert fine == pytest.approx(0.5 * coarse, rel=0.1)
    if coupling == 0.0:
        whole = walk(coupling, 200, half_width, fixed=True)
        jumps = [abs(np.diff(values)).max() for values in (whole[::2], whole)]
        assert jumps[1] > 0.9 * jumps[0] > 5.0 * coarse


@pytest.mark.statistical
@pytest.mark.parametrize("kind", [float, complex])
def test_draws_have_the_laws_of_the_features(kind):
    """Kolmogorov-Smirnov on ln f and 1 - MAC; each fails once in 10,000, and rejects a law with another m."""
    rng = np.random.default_rng(8)
    frequencies, shapes = np.array([1.0, 2.0, 3.0]), np.eye(3, 5) + 0.3
    data = {
        "frequencies": frequencies[[2, 0]],
        "shapes": shapes[[2, 0]].astype(kind),
        "frequency_sd": [0.03, 0.01],
    }
    if kind is complex:
        data["shapes"] = data["shapes"] * np.array([[1j], [1 + 1j]])
    data["shapes"][1, 3] = np.nan
    parameters = checked_parameters((frequencies, shapes), identified(data, None), 0.02, 0.1, "EXP")
    draws = pm.draw(ModalFeature.dist(*parameters, size=(3000, 2)), random_seed=rng)  # all at once
    assert draws.shape == (3000, 2, 6 if kind is float else 11)
    for i, r in enumerate((2, 0)):
        sd = np.hypot(0.02, data["frequency_sd"][i] / data["frequencies"][i])
        z = (np.log(draws[:, i, 0]) - np.log(frequencies[r])) / sd
        assert stats.kstest(z, "norm").pvalue > 1e-4
        drawn = draws[:, i, 1:6] if kind is float else draws[:, i, 1:6] + 1j * draws[:, i, 6:]
        known = ~np.isnan(data["shapes"][i])
        assert not drawn[:, ~known].any()
        np.testing.assert_allclose((abs(drawn) ** 2).sum(axis=1), 1.0, rtol=1e-12)
        e = 1.0 - mac(shapes[r : r + 1, known], drawn[:, known])[0]
        assert stats.kstest(e / 0.01, stats.chi2(2).cdf).pvalue > 1e-4
        assert stats.kstest(e / 0.01, stats.chi2(3).cdf).pvalue < 1e-8


def storeys(theta):
    """Two storeys, the lower of theta times 100 N/m."""
    stiffness = (
        pt.stack([100.0 * theta, 100.0]) if isinstance(theta, pt.TensorVariable) else [100 * theta, 100]
    )
    return SpringMassChain([1.0, 1.0], stiffness, UNDAMPED)


TWO = {"frequencies": np.array([1.02, 2.5]), "shapes": np.array([[0.55, 0.8], [-0.8, 0.6]])}


def exact_quantiles(m, grid):
    """Quantiles of theta and sigma_phi by quadrature; sigma_phi^2 integrates out to an inverse gamma.

    p(theta | y) ~ p(theta) N(ln f) S^-(m), S = sum (1 - MAC) / 2 + b, with sigma_phi^2 ~ InverseGamma(a, b).
    """
    a, b = 3.0, 0.02
    logp = np.empty(grid.size)
    for i, theta in enumerate(grid):
        found = storeys(theta).modes()
        e = 1.0 - mac(TWO["shapes"], found.mode_shapes.T)
        each = stats.norm.logpdf(
            np.log(TWO["frequencies"])[:, None], np.log(found.natural_frequencies)[None], 0.03
        )
        options = []
        for order in ([0, 1], [1, 0]):
            f = sum(each[k, r] for k, r in enumerate(order))
            s = sum(e[k, r] for k, r in enumerate(order))
            options.append(f - (a + m) * np.log(b + 0.5 * s))  # two shapes of m degrees of freedom each
        logp[i] = max(options) + stats.lognorm(0.3).logpdf(theta)
    weight = np.exp(logp - logp.max())
    cdf = np.cumsum(weight) / weight.sum()
    return np.interp([0.05, 0.25, 0.5, 0.75, 0.95], cdf, grid)


@pytest.mark.slow
def test_posterior_of_two_storeys_against_quadrature():
    """Quantiles within 3 % of the 5-95 % width: three standard errors of 4,000 draws at its ends."""
    with pm.Model():
        theta = pm.LogNormal("theta", 0.0, 0.3)
        variance = pm.InverseGamma("variance", 3.0, 0.02)
        found = modes(storeys(theta))
        ModalFeature("y", found, observed=TWO, sigma_f=0.03, sigma_phi=pt.sqrt(variance), density="EXP")
        idata = sample(2000, chains=2, cores=1, check=None, random_seed=3, progressbar=False)
    exact = exact_quantiles(2, np.linspace(0.5, 1.8, 1001))
    got = np.quantile(idata.posterior["theta"], [0.05, 0.25, 0.5, 0.75, 0.95])
    np.testing.assert_allclose(got, exact, rtol=0, atol=0.03 * (exact[-1] - exact[0]))
    assert abs(got - 1.1 * exact).min() > 0.03 * (exact[-1] - exact[0])  # of springs a tenth stiffer


def test_model_has_coordinates_predictive_draws_and_a_log_likelihood_for_each_mode():
    with pm.Model() as model:
        theta = pm.LogNormal("theta", 0.0, 0.1)
        ModalFeature("y", modes(storeys(theta)), observed=TWO, sigma_f=0.03, sigma_phi=0.1, labels=["a", "b"])
        light = {"compile_kwargs": {"mode": LIGHT}}
        idata = pm.sample_prior_predictive(50, random_seed=1, **light)
        posterior = xr.DataTree.from_dict({"posterior": idata.prior.to_dataset().isel(draw=slice(20))})
        predictive = pm.sample_posterior_predictive(posterior, random_seed=2, progressbar=False, **light)
        likelihood = pm.compute_log_likelihood(posterior, progressbar=False, extend_inferencedata=False)
    assert model.coords["y_mode"] == ("a", "b")
    assert model.coords["y_entry"] == ("frequency", "shape 0", "shape 1")
    drawn = predictive.posterior_predictive["y"]
    assert drawn.dims == ("chain", "draw", "y_mode", "y_entry") and drawn.shape[2:] == (2, 3)
    thetas = posterior.posterior["theta"].values.ravel()
    f = np.array([storeys(x).modes().natural_frequencies for x in thetas])
    np.testing.assert_allclose(drawn.sel(y_entry="frequency").values[0], f, rtol=0.2)
    assert likelihood["y"].shape == (1, 20, 2)
    assert "ModalFeature" in model.str_repr()


def test_refusals():
    found = modes(storeys(1.0))
    good = dict(observed=TWO, sigma_f=0.03, sigma_phi=0.1)
    cases = [
        (dict(sigma_phi=None), ValueError, "`sigma_phi` must be given with shapes"),
        (dict(sigma_f=0.0), ValueError, "`sigma_f` must be positive and finite, got 0.0"),
        (dict(sigma_phi=[0.1, -0.1]), ValueError, "`sigma_phi` must be positive"),
        (dict(sigma_f=[0.1] * 3), ValueError, "`sigma_f` must be one value or one for each of the 2 modes"),
        (
            dict(density="GAUSS"),
            ValueError,
            "`density` must be one of TN, EXP, NORMAL or degrees of freedom, got 'GAUSS'",
        ),
        (dict(density=0.0), ValueError, "`density` must be positive"),
        (dict(labels=[1]), ValueError, "`labels` must be 2 labels"),
        (dict(observed={"frequency": [1.0]}), ValueError, "`observed` must be a mapping of frequencies"),
        (
            dict(observed=[1.0, 2.0, 3.0]),
            ValueError,
            "`modes` must have at least as many modes as were identified, 3",
        ),
        (dict(observed=[1.0, np.nan]), ValueError, "`frequencies` must be finite, got nan at index 1"),
        (dict(observed=["a"]), TypeError, "`frequencies` must be an array of numbers"),
        (
            dict(observed=TWO | {"frequency_sd": [1.0]}),
            ValueError,
            r"`frequency_sd` must have shape \(mode,\) = \(2,\)",
        ),
        (dict(observed=TWO | {"shapes": [[1.0, 2.0]]}), ValueError, r"`shapes` must be \(2, channels\)"),
        (
            dict(observed=TWO | {"shapes": np.ones((2, 3))}),
            ValueError,
            "`shapes` must have a column for each of the 2",
        ),
        (dict(observed=TWO | {"shapes": np.zeros((2, 2))}), ValueError, "`shapes` must be not zero"),
        (dict(observed=TWO | {"shapes": np.full((2, 2), np.inf)}), ValueError, "`shapes` must be finite"),
        (dict(observed=TWO | {"shapes": [["a"], ["b"]]}), TypeError, "`shapes` must be an array of numbers"),
    ]
    for change, kind, said in cases:
        with pytest.raises(kind, match=said), pm.Model():
            ModalFeature("y", found, **(good | change))
    with pytest.raises(ValueError, match="`modes` must be frequencies"), pm.Model():
        ModalFeature("y", (np.ones((2, 2)), np.ones((2, 2))), **good)
