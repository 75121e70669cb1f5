"""Bands of responses and first-passage probabilities against brute force, mechanics and closed forms."""

import tracemalloc
import warnings

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy import stats
from scipy.optimize import brentq

import pymc_features as pmf
from benchmarks import truth
from pymc_features import plots, simulators
from pymc_features.prediction import histories
from pymc_features.prediction.first_passage import standard_error
from support.refusals import refusals
from support.sampling import SERIAL
from support.structures import peak_error

UNITS = {
    "absolute_acceleration": "m/s^2",
    "relative_acceleration": "m/s^2",
    "relative_velocity": "m/s",
    "relative_displacement": "m",
    "inter_storey_drift": "m",
    "base_shear": "N",
}
DIM = dict.fromkeys(simulators.QUANTITIES, "sensor") | {"inter_storey_drift": "storey", "base_shear": "row"}
SHAKE = pmf.synthetic_earthquake(6.0, 0.02, random_seed=5, pga=3.0)
OTHER = pmf.synthetic_earthquake(4.0, 0.01, random_seed=8, pga=2.0)


def posterior(**variables):
    """A DataTree of variables (chain, draw, ...)."""
    dims = {
        name: ("chain", "draw", *(f"{name}_{i}" for i in range(np.ndim(v) - 2)))
        for name, v in variables.items()
    }
    data = {name: (dims[name], np.asarray(v, dtype=float)) for name, v in variables.items()}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(data)})


def three_storeys(k, damping=0.05, mass=(3.0, 2.0, 1.0)):
    """Three unequal masses on springs of 400 k N/m."""
    return pmf.SpringMassChain(mass, 400.0 * np.asarray(k) * np.ones(3), pmf.ModalDamping(damping))


@pytest.fixture(scope="module")
def idata():
    """Three springs and a damping ratio, two chains of 60 draws, chains numbered otherwise than by place."""
    rng = np.random.default_rng(1)
    tree = posterior(
        k=np.exp(0.3 * rng.normal(size=(2, 60, 3))),
        damping=rng.uniform(0.01, 0.1, (2, 60)),
        sigma=np.ones((2, 60)),
    )
    tree["posterior"] = xr.DataTree(tree["posterior"].to_dataset().assign_coords(chain=[3, 7]))
    return tree


def all_structures(idata):
    draws = idata["posterior"].to_dataset()
    return [
        three_storeys(draws["k"].values[c, d], draws["damping"].values[c, d])
        for c, d in np.ndindex(draws["damping"].shape)
    ]


def slow_history(structure, record, name, **settings):
    """(row, time) by `simulate` and the definition of each quantity: the obvious way."""
    if name == "inter_storey_drift":
        x = pmf.simulate(structure, record, quantity="relative_displacement", **settings).values
        return np.array([x[0], x[1] - x[0], x[2] - x[1]])
    if name == "base_shear":
        a = pmf.simulate(structure, record, **settings).values
        return (3.0 * a[0] + 2.0 * a[1] + 1.0 * a[2])[None]
    return pmf.simulate(structure, record, quantity=name, **settings).values


# --------------------------------------------------------------------------- bands


@pytest.mark.slow
@pytest.mark.parametrize(
    ("record", "dt", "n_modes"),
    [(SHAKE, None, None), (SHAKE, 0.01, 2), (SHAKE, 0.06, None), (OTHER, 0.02, None)],
)
def test_bands_are_those_of_all_histories(idata, record, dt, n_modes):
    """Every quantity, at the record's, a finer and a coarser step, of this earthquake and another."""
    names, quantiles = list(UNITS), [0.1, 0.5, 0.95]
    settings = {"dt": dt, "n_modes": n_modes}
    found = pmf.posterior_response(idata, three_storeys, record, names, quantiles=quantiles, **settings)
    for name in names:
        slow = np.stack([slow_history(s, record, name, **settings) for s in all_structures(idata)])
        scale = np.abs(slow).max()
        for key, expected in {
            name: np.quantile(slow, quantiles, axis=0),
            f"{name}_mean": slow.mean(axis=0),
            f"{name}_peak": np.abs(slow).max(axis=-1),
        }.items():
            values = (
                found[key]
                if DIM[name] != "row"
                else found[key].expand_dims("row", axis=1 - key.endswith("mean"))
            )
            assert DIM[name] in values.dims
            np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12 * scale, err_msg=key)
            assert found[key].attrs["units"] == UNITS[name]
    np.testing.assert_allclose(found["time"], np.arange(found.sizes["time"]) * (dt or record.dt), atol=1e-12)
    assert found["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(found["quantile"], quantiles)


def test_time_blocks_join(idata, monkeypatch):
    """Blocks of 7 samples, and of one, give the numbers of blocks of 128."""
    whole = pmf.posterior_response(idata, three_storeys, SHAKE, ["base_shear", "relative_velocity"])
    for memory in (8 * 120 * 3 * 7, 1):
        monkeypatch.setattr(histories, "MEMORY", memory)
        found = pmf.posterior_response(idata, three_storeys, SHAKE, ["base_shear", "relative_velocity"])
        xr.testing.assert_allclose(found, whole, rtol=0, atol=1e-11)


def test_chosen_sensors_and_storeys(idata):
    names = ["absolute_acceleration", "inter_storey_drift", "base_shear"]
    every = pmf.posterior_response(idata, three_storeys, SHAKE, names)
    some = pmf.posterior_response(idata, three_storeys, SHAKE, names, sensors=[2, 0])
    np.testing.assert_array_equal(some["storey"], [2, 0])
    xr.testing.assert_allclose(some, every.sel(sensor=[2, 0], storey=[2, 0]), rtol=0, atol=1e-12)


def test_each_peak_knows_its_draw(idata):
    found = pmf.posterior_response(idata, three_storeys, SHAKE, "base_shear", draws=10, random_seed=3)
    assert found.sizes["sample"] == found.attrs["draws_used"] == 10
    assert sorted(set(found["chain"].values)) == [3, 7]
    draws = idata["posterior"].to_dataset()
    for i in range(10):
        one = draws.sel(chain=found["chain"][i], draw=found["draw"][i])
        slow = slow_history(three_storeys(one["k"].values, float(one["damping"])), SHAKE, "base_shear")
        assert float(found["base_shear_peak"][i]) == pytest.approx(np.abs(slow).max(), rel=1e-12)
    again = pmf.posterior_response(idata, three_storeys, SHAKE, "base_shear", draws=10, random_seed=4)
    assert (again["draw"].values != found["draw"].values).any()


def test_draws_are_evenly_spaced():
    """Equally many of each chain, one at least, all when there are few."""
    idata = posterior(k=np.ones((2, 100)))

    def taken(draws):
        found = pmf.posterior_response(idata, three_storeys, OTHER, "base_shear", draws=draws)
        return [found["draw"].values[found["chain"].values == c] for c in (0, 1)]

    for draws in (8, 9):
        first, second = taken(draws)
        assert len(first) == len(second) == 4
        assert (np.diff(first) == 25).all()
    assert [len(d) for d in taken(1)] == [1, 1]
    np.testing.assert_array_equal(taken(500), [np.arange(100)] * 2)


def test_memory_is_bounded():
    """A tenth of what the histories of all draws would take, 200 MB."""
    theta = np.random.default_rng(2).normal(1.0, 0.1, (1, 400))
    record = pmf.synthetic_earthquake(31.2, 0.005, random_seed=1, pga=3.0)
    pmf.posterior_response(posterior(theta=theta[:, :4]), pmf.paper.chain, OTHER)  # imports, compilation
    tracemalloc.start()
    try:
        found = pmf.posterior_response(posterior(theta=theta), pmf.paper.chain, record)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    histories_of_all = 8 * 400 * 10 * found.sizes["time"]
    assert histories_of_all > 190e6
    assert peak < 0.1 * histories_of_all


def test_result_saves(idata, tmp_path):
    found = pmf.posterior_response(
        idata, three_storeys, SHAKE, simulators.quantities_of(three_storeys(100.0))
    )
    found.to_netcdf(tmp_path / "bands.nc", engine="h5netcdf")
    xr.testing.assert_identical(xr.load_dataset(tmp_path / "bands.nc"), found)
    risk = pmf.first_passage_probability(idata, three_storeys, [SHAKE, OTHER], [0.01, 0.1])
    risk.to_netcdf(tmp_path / "risk.nc", engine="h5netcdf")
    xr.testing.assert_equal(xr.load_dataset(tmp_path / "risk.nc"), risk)


# --------------------------------------------------------------------------- draws without a response


def test_impossible_draws_are_left_out_and_counted():
    """A negative stiffness is refused by the structure; one of 1e300 has no response."""
    k = np.ones((2, 4)) * [[1.0], [1.2]]
    possible = pmf.posterior_response(posterior(k=k), three_storeys, SHAKE, "base_shear")
    k = np.concatenate([k, [[-1.0], [1e300]]], axis=1)
    k[0, 1] = np.nan
    with pytest.warns(
        pmf.exceptions.PredictionWarning, match=r"3 of 10 draws have no response .*out: `stiffness` must"
    ):
        found = pmf.posterior_response(posterior(k=k), three_storeys, SHAKE, "base_shear")
    assert (found.attrs["draws_left_out"], found.attrs["draws_used"]) == (3, 7)
    np.testing.assert_array_equal(found["chain"], [0, 0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(found["draw"], [0, 2, 3, 0, 1, 2, 3])
    expected = np.delete(possible["base_shear_peak"].values, 1)
    np.testing.assert_allclose(found["base_shear_peak"], expected, rtol=1e-12)
    assert found["base_shear"].notnull().all()
    with pytest.warns(pmf.exceptions.PredictionWarning, match="3 of 10 draws"):
        risk = pmf.first_passage_probability(posterior(k=k), three_storeys, SHAKE, 1e-9)
    assert (risk.attrs["draws_left_out"], float(risk["probability_any"])) == (3, 1.0)
    with pytest.warns(
        pmf.exceptions.PredictionWarning, match="1 of 2 draws .* frequencies or damping are not finite"
    ):
        pmf.posterior_response(posterior(k=[[1.0, 1e300]]), three_storeys, SHAKE)
    for bad, why in ((-1.0, "none of 2: `stiffness` must be positive"), (1e300, "none of 2. Their freq")):
        with pytest.raises(ValueError, match=f"`structure` must have a response for some draws, got {why}"):
            pmf.posterior_response(posterior(k=[[bad, bad]]), three_storeys, SHAKE)


# --------------------------------------------------------------------------- first passage


def shear_peaks(scale):
    """Mass and stiffness by the same factor: the base shear is proportional to it."""
    return three_storeys(scale, mass=scale * np.array([3.0, 2.0, 1.0]))


def test_first_passage_of_a_proportional_peak():
    """P(c m > limit) of a Normal m in closed form; 4.5 standard errors at five limits."""
    unit = np.abs(slow_history(three_storeys(1.0), SHAKE, "base_shear")).max()
    scale = np.random.default_rng(6).normal(1.0, 0.1, (4, 500))
    limits = unit * np.array([0.85, 0.95, 1.0, 1.1, 1.2])
    found = pmf.first_passage_probability(
        posterior(scale=scale), shear_peaks, SHAKE, limits, "base_shear", draws=2000
    )
    exact = stats.norm(1.0, 0.1).sf(limits / unit)
    assert found["probability"].dims == ("limit",)
    scores = np.abs(found["probability"] - exact) / found["probability_se"]
    assert scores.max() < 4.5
    off = np.abs(found["probability"] - stats.norm(1.03, 0.1).sf(limits / unit)) / found["probability_se"]
    assert off.max() > 4.5, "negative control: a posterior moved by 0.3 standard deviations"
    binomial = np.sqrt(exact * (1.0 - exact) / 2000)
    np.testing.assert_allclose(found["probability_se"], binomial, rtol=0.3)
    np.testing.assert_array_equal(found["probability_any"], found["probability"])
    assert found["limit"].attrs["units"] == "N"


def test_first_passage_of_a_monotone_drift():
    """Peak drift of a mass on a spring, decreasing in the stiffness between 2 and 3: found by bisection."""

    def one_storey(k):
        return pmf.SpringMassChain([1.0], 100.0 * k, pmf.ModalDamping(0.05))

    def peak(k):
        return float(np.abs(pmf.simulate(one_storey(k), PULSE, quantity="relative_displacement")).max())

    PULSE = pmf.Record(np.sin(np.linspace(0.0, 2.0 * np.pi, 201)), dt=0.01)
    assert (np.diff([peak(k) for k in np.linspace(2.0, 3.0, 50)]) < 0.0).all()
    limits = [peak(2.2), peak(2.5), peak(2.9)]
    bounds = [brentq(lambda k, limit=limit: peak(k) - limit, 2.0, 3.0) for limit in limits]
    k = np.random.default_rng(7).uniform(2.0, 3.0, (2, 1000))
    found = pmf.first_passage_probability(posterior(k=k), one_storey, PULSE, limits, draws=2000)
    exact = np.array(bounds) - 2.0  # of a uniform posterior, the share below the bound
    np.testing.assert_allclose(exact, [0.2, 0.5, 0.9], atol=1e-6)
    assert (
        np.abs(found["probability"].isel(storey=0) - exact) < 4.5 * found["probability_se"].isel(storey=0)
    ).all()
    every_draw = (k[..., None] < np.array(bounds)).mean(axis=(0, 1))
    np.testing.assert_array_equal(found["probability"].isel(storey=0), every_draw)


def test_fragility_falls_with_the_limit_and_any_is_more_than_each(idata):
    limits = np.geomspace(0.005, 0.3, 12)
    found = pmf.first_passage_probability(idata, three_storeys, SHAKE, limits)
    assert (found["probability"].diff("limit") <= 0.0).all()
    assert (found["probability_any"].diff("limit") <= 0.0).all()
    assert (found["probability_any"] >= found["probability"].max("storey")).all()
    assert (found["probability_any"] <= found["probability"].sum("storey") + 1e-12).all()
    assert set(np.round(found["probability_any"].values[[0, -1]], 12)) == {0.0, 1.0}
    assert (found["probability_se"] > 0.0).all(), "no exceedance among 120 draws is not certain"
    slow = np.stack([slow_history(s, SHAKE, "inter_storey_drift") for s in all_structures(idata)])
    peaks = np.abs(slow).max(axis=-1)
    np.testing.assert_allclose(found["peak"].isel(record=0), peaks, rtol=1e-10)
    np.testing.assert_array_equal(found["probability"], (peaks > limits[:, None, None]).mean(axis=1))
    np.testing.assert_array_equal(
        found["probability_any"], (peaks.max(axis=1) > limits[:, None]).mean(axis=1)
    )


def test_an_ensemble_of_earthquakes(idata):
    """The total probability is the mean of those of the records, whatever their steps; a number as limit."""
    both = pmf.first_passage_probability(idata, three_storeys, [SHAKE, OTHER], 0.04, sensors=[0, 2])
    for i, record in enumerate((SHAKE, OTHER)):
        alone = pmf.first_passage_probability(idata, three_storeys, record, 0.04, sensors=[0, 2])
        np.testing.assert_array_equal(both["record_probability"][i], alone["probability"])
        np.testing.assert_array_equal(both["record_probability_any"][i], alone["probability_any"])
        assert alone.sizes["record"] == 1
    assert both["record_probability"].dims == ("record", "storey")
    assert both["record_name"].values.tolist() == [SHAKE.name, OTHER.name]
    np.testing.assert_allclose(both["probability"], both["record_probability"].mean("record"), rtol=1e-12)
    np.testing.assert_allclose(
        both["probability_any"], both["record_probability_any"].mean("record"), rtol=1e-12
    )
    assert np.ptp(both["record_probability_any"].values) > 0.0
    assert 0.0 < float(both["probability_any_se"]) < 0.1


def test_standard_error_counts_autocorrelated_draws():
    """Scatter of 300 estimates from chains with correlation 0.8; the binomial error is a third of it."""
    rng = np.random.default_rng(9)
    x = np.empty((300, 2, 400))
    x[..., 0] = rng.normal(size=(300, 2))
    for t in range(1, 400):
        x[..., t] = 0.8 * x[..., t - 1] + 0.6 * rng.normal(size=(300, 2))
    above = (x > 1.0).astype(float)
    used = np.ones((2, 400), dtype=bool)
    errors = standard_error(above.reshape(300, -1), used)
    scatter = above.mean(axis=(1, 2)).std()
    assert np.median(errors) == pytest.approx(scatter, rel=0.2)
    assert np.sqrt(above.mean() * (1.0 - above.mean()) / 800) < 0.55 * scatter, "negative control"
    used[0, :100] = False  # a hole in a chain
    holes = standard_error(above[:, used], used)
    assert np.median(holes) == pytest.approx(scatter * np.sqrt(8 / 7), rel=0.2)


def test_standard_error_of_what_never_happened():
    """Of independent draws by hand; the rule of three, 3 / n, is two to four of them."""
    used = np.ones((1, 300), dtype=bool)
    [error] = standard_error(np.zeros((1, 300)), used)
    p = 0.5 / 301
    assert error == pytest.approx(np.sqrt(p * (1.0 - p) / 300), rel=1e-12)
    assert 2.0 < 3.0 / 300 / error < 5.0
    few = standard_error(np.array([[1.0, 0.0]]), np.ones((2, 1), dtype=bool))
    assert few == pytest.approx(np.sqrt(0.25 / 2))


# --------------------------------------------------------------------------- coverage


@pytest.mark.statistical
def test_bands_cover_the_true_unmeasured_response():
    """Truths from the prior, data at the top, bands of everything else: 90 % of the times are in them.

    Of 20 data sets the share is 0.9 within 4.5 of its standard errors by their scatter. Negative control:
    bands of the 30 % in the middle are not.
    """
    rng = np.random.default_rng(11)
    moved = truth.motion(50.0, 2.98, 5, ends="moving")
    record = pmf.Record(moved.values()[0], 0.02)

    def structure(k):
        return pmf.SpringMassChain([1.0, 1.0], 200.0 * k, pmf.ModalDamping(0.05))

    def exact(k):
        chain = truth.chain_matrices(np.ones(2), 200.0 * k)
        omega, shapes = truth.modes(chain.mass, chain.stiffness)
        return truth.response(chain._replace(damping=shapes * (2.0 * 0.05 * omega) @ shapes.T), moved)

    with pm.Model() as model:
        k = pm.Lognormal("k", 0.0, 0.3, shape=2)
        data = pm.Data("data", np.zeros((1, 150)))
        pm.Normal("y", pmf.response(structure(k), record, sensors=[1]), 0.5, observed=data)
    shares = []
    for i in range(20):
        true = exact(np.exp(0.3 * rng.normal(size=2)))
        measured = true["absolute_acceleration"][[1]] + 0.5 * rng.normal(size=(1, 150))
        with model:
            pm.set_data({"data": measured})
            quick = {"compile_kwargs": {"mode": "FAST_COMPILE"}, **SERIAL}
            sampled = pmf.sample_smc(300, chains=1, random_seed=i, **quick)
        found = pmf.posterior_response(
            sampled, structure, record, ["inter_storey_drift"], quantiles=[0.05, 0.35, 0.65, 0.95]
        )["inter_storey_drift"].values[..., 20:]
        drift = true["inter_storey_drift"][:, 20:]
        shares.append([((found[a] < drift) & (drift < found[3 - a])).mean() for a in (0, 1)])
    wide, narrow = np.transpose(shares)
    error = wide.std(ddof=1) / np.sqrt(len(wide))
    assert error < 0.05
    assert abs(wide.mean() - 0.9) < 4.5 * error
    assert abs(narrow.mean() - 0.9) > 4.5 * error
    assert abs(narrow.mean() - 0.3) < 4.5 * narrow.std(ddof=1) / np.sqrt(len(narrow))


# --------------------------------------------------------------------------- the figure


def test_figure_of_bands(idata):
    found = pmf.posterior_response(idata, three_storeys, SHAKE, ["absolute_acceleration", "base_shear"])
    measured = pmf.simulate(three_storeys(1.0), SHAKE, sensors=[2], dt=0.04)
    axes = pmf.plot_response_bands(found, "absolute_acceleration", measured=measured)
    assert len(axes) == 3
    assert [len(ax.lines) for ax in axes] == [1, 1, 2], "measured at sensor 2 only"
    np.testing.assert_array_equal(
        axes[2].lines[1].get_xydata(), np.stack([measured["time"], measured[0]], axis=1)
    )
    bands = found["absolute_acceleration"].sel(sensor=1)
    np.testing.assert_array_equal(axes[1].lines[0].get_ydata(), bands.sel(quantile=0.5))
    corners = axes[1].collections[0].get_paths()[0].vertices[:, 1]
    assert set(bands.sel(quantile=0.05).values) | set(bands.sel(quantile=0.95).values) <= set(corners)
    assert (axes[1].get_title(), axes[1].get_ylabel()) == ("absolute acceleration, sensor 1", "[m/s²]")
    [again] = pmf.plot_response_bands(
        found, "absolute_acceleration", 1, np.zeros((1, found.sizes["time"])), axes[1]
    )
    assert again is axes[1]
    plots.close(axes[:1])
    shear = np.ones(found.sizes["time"])
    for given in (shear, xr.DataArray(shear, {"time": found["time"]}, "time")):
        [ax] = pmf.plot_response_bands(found, "base_shear", measured=given)
        assert ax.get_title() == "base shear"
        np.testing.assert_array_equal(ax.lines[1].get_ydata(), shear)
        plots.close([ax])


FIGURE_REFUSES = {  # what is said: what is given
    "`quantity` must be one of absolute_acceleration, base_shear, got 'speed'": {"quantity": "speed"},
    r"`sensors` must be among \[0, 1, 2\], got \[5\]. Predict": {"sensors": [5]},
    "`sensors` must be left out for a base_shear, got 0": {"quantity": "base_shear", "sensors": 0},
    r"`measured` must have shape \(sensor, time\) = \(3, 301\) to match.*\(3, 2\)": {
        "measured": np.zeros((3, 2))
    },
    r"`measured` must have dimensions \(sensor, time\), got \('floor": {
        "measured": pmf.simulate(three_storeys(1.0), SHAKE).rename(sensor="floor")
    },
    "`axes` must be one for each of 3 sensors, got 1": {"axes": [None]},
}


@refusals("arguments", FIGURE_REFUSES)
def test_figure_refuses(idata, arguments, match):
    found = pmf.posterior_response(idata, three_storeys, SHAKE, ["absolute_acceleration", "base_shear"])
    with pytest.raises(ValueError, match=match):
        plots.plot_response_bands(**({"result": found, "quantity": "absolute_acceleration"} | arguments))


# --------------------------------------------------------------------------- the border


@pytest.mark.parametrize("form", ["tree", "group", "dataset"])
def test_forms_of_a_posterior(idata, form):
    given = {"tree": idata, "group": idata["posterior"], "dataset": idata["posterior"].to_dataset()}[form]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = pmf.posterior_response(given, three_storeys, OTHER, "base_shear", draws=4)
    assert found.sizes["sample"] == 4


def test_parameters_the_posterior_lacks_keep_their_default():
    found = pmf.posterior_response(
        posterior(k=[[1.0]]), lambda k, damping=0.2: three_storeys(k, damping), OTHER
    )
    exact = pmf.simulate(three_storeys(1.0, 0.2), OTHER)
    assert peak_error(found["absolute_acceleration_mean"], exact) < 1e-13


GROWING = {"k": lambda k: pmf.SpringMassChain(np.ones(1 + int(k > 1)), 1.0, pmf.ModalDamping(0.1))}

REFUSED_VALUES = {  # what is said: what is given
    "`idata` must be a DataTree with a group `posterior`.* got dict. Pass": {"idata": {"k": 1.0}},
    "`idata` must be .*got Dataset": {"idata": xr.Dataset({"k": 1.0})},
    r"`structure` must have parameters .*\(k\), got theta. Rename": {"structure": lambda theta: 1},
    r"`structure` must have parameters .*\(k\), got none": {"structure": lambda: 1},
    r"the same degrees of freedom for every draw, got \[1, 2\]": {"structure": GROWING["k"]},
    "`draws` must be an integer of at least 1, got 0": {"draws": 0},
    "`draws` must be an integer of at least 1, got 1.5": {"draws": 1.5},
    "`dt` must be an integer multiple": {"dt": 0.013},
    "`sensors` must lie between 0 and 2": {"sensors": [3]},
    "`n_modes` must be an integer from 1 to 3, got 4": {"n_modes": 4},
}
REFUSED_TYPES = {
    "`structure` must be a function .* got SpringMassChain": {"structure": three_storeys(1.0)},
    "`structure` must return a structure, got float": {"structure": lambda k: 1.0},
    "return a structure of numbers, got PyTensor": {"structure": lambda k: three_storeys(pt.exp(k))},
    "`record` must be a Record, got ndarray": {"record": SHAKE.acceleration},
}


@refusals("arguments", REFUSED_VALUES, REFUSED_TYPES)
@pytest.mark.parametrize("function", [pmf.posterior_response, pmf.first_passage_probability])
def test_refusals(function, arguments, error, match):
    defaults = {"idata": posterior(k=[[0.5, 1.5]]), "structure": three_storeys, "record": SHAKE}
    if function is pmf.first_passage_probability:
        defaults["limit"] = 0.1
    with pytest.raises(error, match=match):
        function(**(defaults | arguments))


REFUSALS_OF_ONE = {  # what is said: what is given
    r"`quantities` must be of .*base_shear, got \['stress'\]": (
        pmf.posterior_response,
        {"quantities": ["stress"]},
    ),
    r"`quantities` must be of .*, got \[\]": (pmf.posterior_response, {"quantities": []}),
    r"`quantiles` must lie between 0 and 1, got \[5, 95\]. Pass": (
        pmf.posterior_response,
        {"quantiles": [5, 95]},
    ),
    "`quantity` must be one of .*, got 'drift'": (
        pmf.first_passage_probability,
        {"limit": 0.1, "quantity": "drift"},
    ),
    r"`limit` must be a positive number or .*got \[0.1, -1.0": (
        pmf.first_passage_probability,
        {"limit": [0.1, -1.0]},
    ),
    "`record` must be one Record or several, got none": (
        pmf.first_passage_probability,
        {"limit": 0.1, "record": []},
    ),
    r"`quantity` must be one of .*, got \['base": (
        pmf.first_passage_probability,
        {"limit": 0.1, "quantity": ["base_shear"]},
    ),
}


@refusals("function arguments", REFUSALS_OF_ONE)
def test_refusals_of_one(function, arguments, match):
    defaults = {"idata": posterior(k=[[0.5, 1.5]]), "structure": three_storeys, "record": SHAKE}
    with pytest.raises(ValueError, match=match):
        function(**(defaults | arguments))


@pytest.mark.parametrize(
    "predict", [pmf.posterior_response, lambda *a, **k: pmf.first_passage_probability(*a, 1.0, **k)]
)
def test_options_of_the_response_are_known_by_name(predict):
    with pytest.raises(
        TypeError, match=r"its own or dt, sensors, n_modes, outputs, got 'modes'. Did you mean"
    ):
        predict(posterior(k=[[1.0]]), three_storeys, SHAKE, modes=2)
