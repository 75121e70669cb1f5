"""Exact posteriors of the study against closed forms, SciPy and sums over fine grids."""

import numpy as np
import pytest
from scipy import linalg, stats

from pymc_features import simulate
from pymc_features.likelihoods import LIKELIHOODS, abc_tolerance
from pymc_features.study import STRUCTURES, find_structure, paper
from pymc_features.study.exact import (
    OWN_POSTERIORS,
    DiscrepancyCurve,
    Exponents,
    Stretch,
    correlated_exponents,
    exact_posterior,
    reference,
    tolerance_interval,
    unknown_time_posterior,
    weighted_square,
)
from pymc_features.study.results import verdict
from pymc_features.study.settings import Study
from pymc_features.study.structures import YIELD_DISPLACEMENT, bouc_wen_chain
from support.straight import Record

pytestmark = pytest.mark.slow

KINDS = ("NORM", "TN", "EXP")
STEPS = (0.1, 1.0, 10.0)  # the finest and the coarsest of `paper.MULTIPLIERS`
DT, N_TIMES, N_SENSORS = 0.02, 40, 3
QUANTILES = [0.05, 0.5, 0.95]


@pytest.fixture(scope="module")
def exact(record):
    """Curves, exact posteriors and likelihoods on the whole record at three of the steps."""
    study = Study(record, random_seed=0)
    result = []
    for multiplier in STEPS:
        curve = study.misfit(multiplier).curve
        laws = {kind: LIKELIHOODS[kind].exponents(*study.data(multiplier).shape) for kind in KINDS}
        posteriors = {kind: exact_posterior(curve, law, paper.SIGMA_RANGE) for kind, law in laws.items()}
        result.append((curve, posteriors, laws))
    return result


@pytest.mark.parametrize("kind", KINDS)
def test_marginal_is_the_student_t_of_the_closed_form(exact, kind):
    """S^(-(m - 1)/2) with quadratic S: a Student-t; at 0.1 % of the 5-95 % width."""
    for curve, posteriors, laws in exact:
        m = laws[kind].m
        scale = np.sqrt(curve.minimum / curve.curvature / (m - 2))
        closed = curve.minimiser + scale * stats.t(m - 2).ppf([0.05, 0.25, 0.5, 0.75, 0.95])
        quantiles = posteriors[kind].marginals["theta"].quantile([0.05, 0.25, 0.5, 0.75, 0.95])
        width = closed[-1] - closed[0]
        # S is quadratic near its minimum only: the heavier the tail, the more of its cubic part is seen
        np.testing.assert_allclose(np.ptp(quantiles[[0, -1]]), width, rtol=1e-3)
        np.testing.assert_allclose(quantiles, closed, atol=(0.01 if kind != "NORM" else 1e-3) * width)


def test_feature_and_abc_uncertainty_do_not_depend_on_the_sampling_rate(exact):
    """Half-widths of ABC's sets in closed form. NORM is the negative control: a hundred samples, a tenth."""
    width = {
        kind: np.array([np.ptp(p[kind].marginals["theta"].quantile([0.05, 0.95])) for _, p, _ in exact])
        for kind in KINDS
    }
    width["ABC"] = np.array([])
    for curve, posteriors, _ in exact:
        delta = abc_tolerance(float(posteriors["EXP"].marginals["sigma"].quantile(0.9)), paper.N_STOREYS)
        ends = np.array(tolerance_interval(curve, delta))
        closed = np.sqrt((delta - curve.minimum) / curve.curvature)
        assert np.ptp(ends) == pytest.approx(2.0 * closed, rel=1e-3)
        assert [curve.total(end) for end in ends] == pytest.approx([delta] * 2, rel=1e-9)
        width["ABC"] = np.append(width["ABC"], 0.9 * np.ptp(ends))
        with pytest.raises(ValueError, match="`delta` must exceed the smallest discrepancy"):
            tolerance_interval(curve, 0.999 * curve.minimum)
    for kind in ("TN", "EXP", "ABC"):
        assert width[kind].max() / width[kind].min() < 1.03
    # at the 90 % quantile it is wider than TN's interval, and less than twice as wide as EXP's
    assert (width["ABC"] > width["TN"]).all() and (width["ABC"] < 2.2 * width["EXP"]).all()
    assert width["NORM"][-1] / width["NORM"][0] == pytest.approx(10.0, rel=0.1)
    assert (np.diff(width["NORM"]) > 0).all()


@pytest.mark.parametrize("factors", [None, (0.6, 1.0 / 0.6)])
def test_quadrature_against_sums_on_a_fine_grid(factors):
    """The same density, of a stretched likelihood too, summed in the parameters: quantiles and evidence."""
    minimum, curvature, centre = 0.07, 300.0, 1.01
    curve = DiscrepancyCurve(lambda t: minimum + curvature * (t - centre) ** 2, (0.5, 1.5), 40)
    likelihood = Exponents(25.0, 20.0, -3.0)
    best = np.sqrt(likelihood.c * minimum / likelihood.m)
    pair = factors or (1.0, 1.0)
    stretches = Stretch((0.5, 1.5), centre, pair[0]), Stretch((0.0, 2.0), best, pair[1])
    named = {"theta": stretches[0], "sigma": stretches[1]} if factors else None
    found = exact_posterior(curve, likelihood, (0.0, 2.0), stretches=named)
    theta, sigma = ((np.arange(2000) + 0.5) / 2000 + 0.5, (np.arange(2000) + 0.5) / 1000)
    x, s = stretches[0].inside(theta)[:, None], stretches[1].inside(sigma)
    total = minimum + curvature * (x - centre) ** 2
    mass = np.exp(-likelihood.m * np.log(s) - likelihood.c * total / (2 * s**2))
    assert found.log_evidence == pytest.approx(np.log(mass.mean()) - 3.0, abs=1e-5)
    for name, nodes, axis in (("theta", theta, 1), ("sigma", sigma, 0)):
        quantiles = found.marginals[name].quantile(QUANTILES)
        np.testing.assert_allclose(quantiles, quantiles_of(nodes, mass.sum(axis=axis)), rtol=1e-4)
    assert found.map == pytest.approx((centre, best))


def quantiles_of(nodes, mass):
    """5, 50 and 95 % of masses at the middles of even cells."""
    return np.interp(QUANTILES, (np.cumsum(mass) - 0.5 * mass) / mass.sum(), nodes)


def test_exponents_reproduce_the_likelihoods():
    """-m ln sigma - c S / (2 sigma^2) + constant equals SciPy's densities, summed."""
    rng = np.random.default_rng(5)
    misfit, sigma = rng.normal(size=(3, 40)), 0.7
    e = np.mean(misfit**2, axis=1)
    expected = {
        "NORM": stats.norm(scale=sigma).logpdf(misfit).sum(),
        "TN": stats.halfnorm(scale=sigma).logpdf(np.sqrt(e)).sum(),
        "EXP": stats.expon(scale=2 * sigma**2).logpdf(e).sum(),
    }
    for kind, value in expected.items():
        it = LIKELIHOODS[kind].exponents(3, 40)
        got = -it.m * np.log(sigma) - it.c * e.sum() / (2 * sigma**2) + it.constant
        assert got == pytest.approx(value, rel=1e-12)


# --------------------------------------------------------------------------- errors correlated in time


def sums_of(misfit):
    """S, D, first and last square of a misfit (sensor, time)."""
    increments = np.sum(np.diff(misfit, axis=1) ** 2)
    return np.array([np.sum(misfit**2), increments, np.sum(misfit[:, 0] ** 2), np.sum(misfit[:, -1] ** 2)])


@pytest.mark.parametrize("tau", [1e-4, 0.3, 20.0])
def test_weighted_square_and_determinant_are_those_of_the_dense_matrix(tau):
    misfit = np.random.default_rng(0).normal(size=(N_SENSORS, N_TIMES))
    lags = DT * np.arange(N_TIMES)
    correlation = np.exp(-np.abs(np.subtract.outer(lags, lags)) / tau)
    expected = np.sum(misfit * linalg.solve(correlation, misfit.T, assume_a="pos").T)
    assert weighted_square(sums_of(misfit), DT, tau) == pytest.approx(expected, rel=1e-9)
    log_p = stats.multivariate_normal(cov=0.49 * correlation).logpdf(misfit).sum()
    it = correlated_exponents(N_SENSORS, N_TIMES, DT, tau)
    got = it.constant - it.m * np.log(0.7) - it.c * expected / (2 * 0.49)
    assert got == pytest.approx(log_p, rel=1e-9)


def parabola(theta):
    """Misfit of a linear model with a little noise."""
    rng = np.random.default_rng(4)
    slope, noise = rng.normal(size=(2, N_SENSORS, N_TIMES))
    return 0.1 * noise + (theta - 1.02) * slope


def coefficients(values):
    """a, b, c of a x^2 + b x + c at x = -1, 0, 1."""
    return 0.5 * (values[0] - 2 * values[1] + values[2]), 0.5 * (values[2] - values[0]), values[1]


def test_known_scale_posterior_is_the_normal_of_the_linear_model():
    """Misfit linear in theta: the posterior is Gaussian, and so is the evidence."""
    tau, sigma = 0.05, 0.1

    def total(theta):
        return float(weighted_square(sums_of(parabola(theta)), DT, tau))

    curve = DiscrepancyCurve(total, (0.5, 1.5), N_SENSORS * N_TIMES)
    it = correlated_exponents(N_SENSORS, N_TIMES, DT, tau)
    found = exact_posterior(curve, it, sigma=sigma)
    a, b, _ = coefficients([total(t) for t in (0.0, 1.0, 2.0)])
    normal = stats.norm(1.0 - b / (2 * a), sigma / np.sqrt(a))
    q = np.array([0.01, 0.05, 0.5, 0.95, 0.99])
    np.testing.assert_allclose(found.marginals["theta"].quantile(q), normal.ppf(q), atol=1e-4 * normal.std())
    top = it.constant - it.m * np.log(sigma) - total(normal.mean()) / (2 * sigma**2)
    expected = top + 0.5 * np.log(2 * np.pi) + np.log(normal.std())
    assert found.log_evidence == pytest.approx(expected, abs=1e-6)


def test_unknown_time_posterior_against_sums_on_a_fine_grid():
    """The density in theta, sigma and ln(tau) at the middles of cells: marginals and evidence."""
    bounds, sigma_bounds, tau_bounds, n = (0.5, 1.5), (0.0, 2.0), (1e-3, 0.5), N_SENSORS * N_TIMES
    a, b, c = coefficients([sums_of(parabola(t)) for t in (0.0, 1.0, 2.0)])  # the sums are parabolas

    def sums(theta):
        x = np.asarray(theta) - 1.0
        return np.stack([a[k] * x**2 + b[k] * x + c[k] for k in range(4)])

    curve = DiscrepancyCurve(lambda t: float(sums(t)[0]) / N_TIMES, bounds, n)
    exact = unknown_time_posterior(curve, sums, (N_SENSORS, N_TIMES), DT, sigma_bounds[1], tau_bounds)
    best, log_evidence = exact.map, exact.log_evidence
    ends = (best[0] - 0.15, best[0] + 0.15), (0.5 * best[1], 2.0 * best[1]), np.log(tau_bounds)
    theta, sigma, log_tau = (low + np.ptp([low, high]) * (np.arange(200) + 0.5) / 200 for low, high in ends)
    tau = np.exp(log_tau)
    weighted = weighted_square(sums(theta)[:, :, None], DT, tau)[:, None]  # (theta, sigma, tau)
    constant = correlated_exponents(N_SENSORS, N_TIMES, DT, tau).constant
    log_p = constant - n * np.log(sigma)[:, None] - 0.5 * weighted / sigma[:, None] ** 2
    mass = np.exp(log_p - log_p.max())
    volume = np.prod([np.ptp(end) for end in ends]) / (
        np.ptp(bounds) * np.ptp(sigma_bounds) * np.ptp(ends[2])
    )
    assert log_evidence == pytest.approx(np.log(mass.mean() * volume) + log_p.max(), abs=1e-3)
    for axis, (name, nodes) in enumerate({"theta": theta, "sigma": sigma, "tau": tau}.items()):
        found = exact.marginals[name].quantile(np.array(QUANTILES))
        expected = quantiles_of(nodes, mass.sum(axis=tuple({0, 1, 2} - {axis})))
        np.testing.assert_allclose(found, expected, atol=0.01 * (found[2] - found[0]))


def widths(record, kind, multipliers=(0.2, 1.0), seed=0, **settings):
    """Exact 5-95 % width of theta at two sampling steps."""
    study = Study(record, random_seed=seed, multipliers=multipliers, **settings)
    rows = [reference(kind, study.misfit(m)).statistics[0] for m in multipliers]
    return np.array([row[3] - row[1] for row in rows])


def test_which_models_of_correlated_errors_converge(record):
    """0.1 against 0.2 of the record's step: CN within 5 %, NORM is the control.

    With the scale inferred from white noise sigma^2 grows like tau / dt, and the width with its root; with
    the time inferred white noise is found.
    """
    short = Record(record.acceleration[:501], record.dt)
    width = {kind: widths(short, kind, (0.1, 0.2)) for kind in ("CN", "CN-SIGMA", "CN-TAU", "NORM")}
    assert width["CN"][0] == pytest.approx(width["CN"][1], rel=0.05)
    assert width["NORM"][0] < 0.8 * width["NORM"][1]
    assert width["CN-SIGMA"][0] / width["CN-SIGMA"][1] == pytest.approx(np.sqrt(2.0), rel=0.05)
    np.testing.assert_allclose(width["CN-TAU"], width["NORM"], rtol=0.02)


def test_cal_takes_its_width_from_the_residuals(record):
    """Of errors that persist a fifth of the step changes it by 10 % at most; NORM is the control.

    What is right for these errors is CN, which knows their correlation, and weighs the data better for it.
    Of white errors every sample is new, as NORM takes them: one estimate of a variability is right to 20 %.
    """
    settings = {"noise_time": 0.05, "seed": 4}  # noise about which frequency bands agree
    calibrated, norm, known = (widths(record, kind, **settings) for kind in ("CAL", "NORM", "CN"))
    assert calibrated[0] == pytest.approx(calibrated[1], rel=0.1)
    assert norm[0] < 0.5 * norm[1]
    assert ((calibrated > 0.9 * known) & (calibrated < 1.5 * known)).all()
    np.testing.assert_allclose(widths(record, "CAL"), widths(record, "NORM"), rtol=0.25)


# --------------------------------------------------------------------------- springs that yield


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_of_the_study(name, record):
    """What every entry of the catalogue must do."""
    entry = find_structure(name)
    nominal, changed = entry.chain(1.0, stiffness=1500.0), entry.chain(1.2, stiffness=1500.0)
    assert nominal.n_dof == paper.N_STOREYS
    np.testing.assert_allclose(nominal.stiffness, 1500.0)
    np.testing.assert_allclose(changed.stiffness, [1800.0] * 3 + [1500.0] * 7)
    np.testing.assert_array_equal(entry.chain().matrices(), paper.chain().matrices())
    assert np.isfinite(simulate(changed, Record(record.acceleration[:50], record.dt))).all()
    assert set(entry.likelihoods) <= set(LIKELIHOODS) and entry.quick["draws"] < entry.draws
    softer = find_structure(name, stiffness=1500.0)
    study = Study(record, random_seed=0, structure=softer, likelihoods=["TN"], multipliers=[10.0])
    assert (study.draws, study.chains, study.structure) == (entry.draws, entry.chains, softer)
    np.testing.assert_array_equal(study.at(1.2).stiffness, changed.stiffness)


def test_yielding_is_as_stated(record):
    """Ductility from 2 to 5 in several storeys; the drifts stated for El Centro, here by differences."""
    positions = simulate(bouc_wen_chain(), record, quantity="relative_displacement").values
    drifts = np.abs(np.diff(positions, axis=0, prepend=0.0)).max(axis=1)
    ductility = drifts / YIELD_DISPLACEMENT
    np.testing.assert_allclose(ductility[:7], [4.2, 3.6, 3.0, 3.1, 2.9, 2.1, 1.4], atol=0.05)
    assert (ductility[7:] < 1.0).all()
    linear = simulate(paper.chain(), record, quantity="relative_displacement", sensors=[0])
    assert np.abs(linear.values).max() / YIELD_DISPLACEMENT == pytest.approx(5.8, abs=0.05)


@pytest.fixture(scope="module")
def yielding(record):
    """A study of the first 2.6 s, in which springs yield."""
    short = Record(record.acceleration[:131], record.dt, name="beginning")
    return Study(short, random_seed=0, structure="bouc-wen", multipliers=(0.5, 1.0, 5.0))


def direct_sums(study, theta, multiplier):
    """The four sums from a response simulated at the sampling step itself."""
    response = simulate(study.at(theta), study.record, dt=multiplier * study.record.dt).values
    misfit = study.data(multiplier).values - response
    return sums_of(misfit)


@pytest.mark.parametrize("theta", [0.6137, 0.99931, 1.377])
def test_shared_responses_serve_every_step(yielding, theta):
    """1e-6 of S: the integration's error, and the splines' where the posteriors are; further off 1e-4."""
    accuracy = 1e-6 if abs(theta - 1.0) < 0.04 else 1e-4
    for multiplier in yielding.multipliers:
        expected = direct_sums(yielding, theta, multiplier)
        got = yielding.misfit(multiplier).sums(theta)
        np.testing.assert_allclose(got, expected, rtol=accuracy, atol=1e-9 * expected[0])
        # negative control: the data of another step
        other = direct_sums(yielding, theta, 1.0 if multiplier != 1.0 else 5.0)
        assert abs(got[1] / other[1] - 1.0) > 1e3 * accuracy


def test_uncertainty_of_springs_that_yield_does_not_depend_on_the_sampling_rate(yielding):
    """As of the linear chain: half the step or five times it; NORM is the control."""
    width = {
        kind: np.array(
            [np.ptp(reference(kind, yielding.misfit(m)).statistics[0, 1:]) for m in (0.5, 1.0, 5.0)]
        )
        for kind in (*KINDS, "ABC")
    }
    for kind in ("TN", "EXP", "ABC"):
        assert width[kind].max() / width[kind].min() < 1.1
    assert width["NORM"][2] / width["NORM"][0] == pytest.approx(np.sqrt(10.0), rel=0.15)


# --------------------------------------------------------------------------- words


def test_entries_of_the_catalogue():
    """What every likelihood must state."""
    entries = LIKELIHOODS.values()
    assert (
        len({entry.meaning for entry in entries}) == len({entry.colour for entry in entries}) == len(entries)
    )
    for kind, entry in LIKELIHOODS.items():
        assert entry.name == kind
        assert set(entry.takes) <= {"sigma", "correlation_time", "m", "epsilon"}
        assert not entry.calibrates or LIKELIHOODS[entry.calibrates].takes == entry.takes
        assert set(entry.known) | set(entry.inferred) <= set(entry.takes)
        assert not set(entry.known) & set(entry.inferred)
        assert entry.exponents is None or kind not in OWN_POSTERIORS
        assert set(entry.reasons) <= {"narrows", "widens"}


@pytest.mark.parametrize(
    ("kind", "width", "words"),
    [
        ("NORM", [1.0, 2**0.5, 4.0], "narrows as the step shrinks, like its power 0.5: sampling faster is"),
        (
            "CN-SIGMA",
            [2**0.5, 1.0, 4.0],
            "widens as the step shrinks, like its power -0.5: the errors do",
        ),
        ("CN", [1.0, 1.01, 4.0], "settles: 0.99% between the two smallest steps"),
        ("CN", [1.0], "one sampling step only"),
    ],
)
def test_verdicts_in_words(kind, width, words):
    assert verdict(kind, [0.1, 0.2, 1.0][: len(width)], width).startswith(words)
