"""Bands of responses and first-passage probabilities against brute force, mechanics and closed forms."""

import tracemalloc
import warnings

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy import stats

import pymc_features as pmf
from benchmarks import truth
from pymc_features import plots, simulators
from pymc_features.prediction import ensemble, first_passage_probability, posterior_response
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
SHAKE = pmf.synthetic_earthquake(4.0, 0.02, random_seed=5, pga=3.0)
OTHER = pmf.synthetic_earthquake(3.0, 0.01, random_seed=8, pga=2.0)
LOADS = {
    "two supports": pmf.Loading(np.random.default_rng(2).normal(size=(2, 80)), 0.02, name="two"),
    "forces": pmf.Loading(
        np.random.default_rng(3).normal(size=(2, 80)), 0.02, kind="force", matrix=[[1, 0], [0, 2], [3, -1]]
    ),
    "nodal forces": pmf.Loading(np.random.default_rng(4).normal(size=(3, 80)), 0.02, kind="force"),
}
RAYLEIGH = pmf.RayleighDamping(0.3, 2e-3)
MASS = np.array([3.0, 2.0, 1.0])
DRIFTS = np.eye(3) - np.eye(3, k=-1)
SHARE = np.array([[0.9, 0.1], [0.6, 0.4], [0.2, 0.8]])


def posterior(**variables):
    """A DataTree of variables (chain, draw, ...)."""
    dims = {
        name: ("chain", "draw", *(f"{name}_{i}" for i in range(np.ndim(v) - 2)))
        for name, v in variables.items()
    }
    data = {name: (dims[name], np.asarray(v, dtype=float)) for name, v in variables.items()}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(data)})


@pytest.fixture(scope="module")
def idata():
    """Three springs and a damping ratio, two chains of 15 draws, chains numbered otherwise than by place."""
    rng = np.random.default_rng(1)
    k, damping = np.exp(0.3 * rng.normal(size=(2, 15, 3))), rng.uniform(0.01, 0.1, (2, 15))
    tree = posterior(k=k, damping=damping, sigma=np.ones((2, 15)))
    tree["posterior"] = xr.DataTree(tree["posterior"].to_dataset().assign_coords(chain=[3, 7]))
    return tree


def chain(k, damping=0.05, mass=MASS):
    """Three unequal masses on springs of 400 k N/m."""
    return pmf.SpringMassChain(mass, 400.0 * np.asarray(k) * np.ones(3), pmf.ModalDamping(damping))


def frame(k, influence=None):
    """The same chain by its matrices."""
    mass, _, stiffness = chain(k).matrices()
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=RAYLEIGH, influence=influence)


def dashpot(k):
    """With a dashpot at the top that couples the modes."""
    mass, damping, stiffness = frame(k).matrices()
    damping[2, 2] += 2.0
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=damping)


def two_supports(k):
    return frame(k, SHARE)


def without_top_mass(k):
    """The top has no mass and follows the floor below."""
    mass, _, stiffness = chain(k).matrices()
    mass[2, 2] = 0.0
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=RAYLEIGH)


def bouc_wen(k):
    return pmf.HystereticChain(MASS, 400.0 * k, RAYLEIGH, yield_displacement=0.01, post_yield_ratio=0.1)


def duffing(k):
    return pmf.DuffingChain(MASS, 400.0 * k, RAYLEIGH, cubic=2e5)


def of_several_kinds(k):
    """Chains, modes, coupled damping and Bouc-Wen springs in turn."""
    return (chain, dashpot, frame, bouc_wen)[int(1e6 * k[0]) % 4](k)


def structures_of(idata, structure):
    draws = idata["posterior"].to_dataset()
    values = zip(draws["k"].values.reshape(-1, 3), draws["damping"].values.ravel(), strict=True)
    return [chain(*pair) if structure is chain else structure(pair[0]) for pair in values]


def slow_history(structure, load, name, **settings):
    """(..., time) by `simulate`; drift and shear of a chain by their definitions: the obvious way."""
    if isinstance(structure, pmf.SpringMassChain) and name == "inter_storey_drift":
        x = pmf.simulate(structure, load, quantity="relative_displacement", **settings).values
        return np.diff(x, axis=0, prepend=0.0)
    if isinstance(structure, pmf.SpringMassChain) and name == "base_shear":
        return structure.mass @ pmf.simulate(structure, load, **settings).values
    return pmf.simulate(structure, load, quantity=name, **settings).values


def assert_bands(found, name, slow):
    """Bands, mean and peaks of a quantity against those of all histories (sample, ..., time)."""
    expected = {
        name: np.quantile(slow, found["quantile"], axis=0),
        f"{name}_mean": slow.mean(axis=0),
        f"{name}_peak": np.abs(slow).max(axis=-1),
    }
    for key, values in expected.items():
        assert found[key].shape == values.shape, key
        atol = 1e-12 * np.abs(slow).max()
        np.testing.assert_allclose(found[key], values, rtol=0, atol=atol, err_msg=key)
        assert found[key].attrs["units"] == UNITS[name]


# --------------------------------------------------------------------------- bands

BLOCKS = 8 * 30 * 3 * 7  # bytes, of 7 samples
CASES = [  # structure, load, settings of the response, bytes of memory
    (chain, SHAKE, {}, BLOCKS),
    (chain, SHAKE, {"dt": 0.01, "n_modes": 2}, ensemble.MEMORY),
    (chain, SHAKE, {"dt": 0.04}, 1),
    (chain, OTHER, {"dt": 0.02}, ensemble.MEMORY),
    (frame, OTHER, {"dt": 0.02, "n_modes": 1}, ensemble.MEMORY),
    *((two_supports, load, {}, ensemble.MEMORY) for load in LOADS.values()),
    (two_supports, LOADS["forces"], {"dt": 0.01, "n_modes": 2}, ensemble.MEMORY),
    (without_top_mass, SHAKE, {}, ensemble.MEMORY),
    (dashpot, SHAKE, {"n_modes": 2}, ensemble.MEMORY),
    (bouc_wen, SHAKE, {"dt": 0.01}, BLOCKS),
    (bouc_wen, SHAKE, {"dt": 0.04}, 1),
    (duffing, SHAKE, {}, ensemble.MEMORY),
    (of_several_kinds, SHAKE, {}, BLOCKS),
    (of_several_kinds, SHAKE, {}, ensemble.MEMORY),
]


@pytest.mark.slow
@pytest.mark.parametrize(("structure", "load", "settings", "memory"), CASES)
def test_bands_are_those_of_all_histories(idata, structure, load, settings, memory, monkeypatch):
    """Every quantity, of this earthquake, another and forces, at the record's step and others.

    In memory, in blocks of 7 samples on disk, and of one.
    """
    monkeypatch.setattr(ensemble, "MEMORY", memory)
    many = structures_of(idata, structure)
    drifts = all(
        isinstance(one, pmf.SpringMassChain | pmf.HystereticChain | pmf.DuffingChain) for one in many
    )
    names = list(UNITS) if drifts else [name for name in UNITS if name != "inter_storey_drift"]
    if structure is without_top_mass:
        names.remove("base_shear")
    found = posterior_response(idata, structure, load, names, quantiles=[0.1, 0.5, 0.95], **settings)
    for name in names:
        assert_bands(found, name, np.stack([slow_history(one, load, name, **settings) for one in many]))
    dt = settings.get("dt") or load.dt
    np.testing.assert_allclose(found["time"], np.arange(found.sizes["time"]) * dt, atol=1e-12)
    assert found["time"].attrs["units"] == "s" and found["quantile"].values.tolist() == [0.1, 0.5, 0.95]
    dims = {"inter_storey_drift": ("quantile", "storey", "time"), "base_shear": ("quantile", "time")}
    if structure is two_supports:
        dims["base_shear"] = "quantile", "support", "time"
        axes = pmf.plots.response(found, "base_shear")
        assert axes[1].get_title() == "base shear, support 1"
        plots.close(axes)
    assert all(found[name].dims == dims.get(name, ("quantile", "sensor", "time")) for name in names)


@pytest.mark.parametrize("structure", [chain, frame, dashpot, bouc_wen])
def test_combinations_and_chosen_sensors(idata, structure):
    many = structures_of(idata, structure)
    asked = {"quantity": "relative_velocity", "outputs": DRIFTS[1:]}
    found = posterior_response(idata, structure, OTHER, "relative_velocity", outputs=DRIFTS[1:])
    assert found["sensor"].attrs["long_name"] == "row of outputs"
    assert_bands(found, "relative_velocity", np.stack([pmf.simulate(s, OTHER, **asked) for s in many]))
    names = ["relative_velocity", "base_shear"] + ["inter_storey_drift"] * (structure in (chain, bouc_wen))
    every = posterior_response(idata, structure, OTHER, names)
    some = posterior_response(idata, structure, OTHER, names, sensors=[2, 0])
    chosen = {"sensor": [2, 0]} | ({"storey": [2, 0]} if "storey" in every.dims else {})
    xr.testing.assert_allclose(some, every.sel(chosen), rtol=0, atol=1e-12)


def test_forces_where_no_mass_is(idata):
    """Bands of the others and of the base shear."""
    push = pmf.Loading(SHAKE.acceleration, SHAKE.dt, kind="force", matrix=[[0.0], [0.0], [1.0]])
    posterior_response(idata, without_top_mass, push, "base_shear")
    posterior_response(idata, without_top_mass, push, sensors=[0, 1])
    with pytest.raises(ValueError, match="`sensors` must lie on mass"):
        posterior_response(idata, without_top_mass, push)


def test_each_peak_knows_its_draw(idata):
    found = posterior_response(idata, chain, SHAKE, "base_shear", draws=10, random_seed=3)
    assert found.sizes["sample"] == found.attrs["draws_used"] == 10
    assert sorted(set(found["chain"].values)) == [3, 7]
    draws = idata["posterior"].to_dataset()
    for i in range(10):
        one = draws.sel(chain=found["chain"][i], draw=found["draw"][i])
        slow = slow_history(chain(one["k"].values, float(one["damping"])), SHAKE, "base_shear")
        assert float(found["base_shear_peak"][i]) == pytest.approx(np.abs(slow).max(), rel=1e-12)
    again = posterior_response(idata, chain, SHAKE, "base_shear", draws=10, random_seed=4)
    assert (again["draw"].values != found["draw"].values).any()


def test_draws_are_evenly_spaced():
    """Equally many of each chain, one at least, all when there are few."""
    idata = posterior(k=np.ones((2, 100)))

    def taken(draws):
        found = posterior_response(idata, chain, OTHER, "base_shear", draws=draws)
        return [found["draw"].values[found["chain"].values == c] for c in (0, 1)]

    for draws in (8, 9):
        first, second = taken(draws)
        assert len(first) == len(second) == 4
        assert (np.diff(first) == 25).all()
    assert [len(d) for d in taken(1)] == [1, 1]
    np.testing.assert_array_equal(taken(500), [np.arange(100)] * 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "size", "memory", "share"),
    [(pmf.paper.chain, (400,), ensemble.MEMORY, 0.1), (dashpot, (300, 3), 2**20, 0.4)],
)
def test_memory_is_bounded(structure, size, memory, share, monkeypatch):
    """A part of what the histories of all draws would take, 200 MB of a chain, 11 MB with coupled damping."""
    monkeypatch.setattr(ensemble, "MEMORY", memory)
    draws = np.random.default_rng(2).uniform(0.9, 1.2, (1, *size))
    name = "theta" if structure is pmf.paper.chain else "k"
    record = pmf.synthetic_earthquake(31.2, 0.005 if name == "theta" else 0.02, random_seed=1, pga=3.0)
    posterior_response(posterior(**{name: draws[:, :4]}), structure, OTHER)  # imports, compilation
    tracemalloc.start()
    try:
        found = posterior_response(posterior(**{name: draws}), structure, record)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    histories_of_all = 8 * size[0] * found.sizes["sensor"] * found.sizes["time"]
    assert histories_of_all > 10e6
    assert peak < share * histories_of_all


def test_result_saves(idata, tmp_path):
    found = posterior_response(idata, chain, SHAKE, simulators.quantities_of(chain(100.0)))
    found.to_netcdf(tmp_path / "bands.nc", engine="h5netcdf")
    xr.testing.assert_identical(xr.load_dataset(tmp_path / "bands.nc"), found)
    risk = first_passage_probability(idata, chain, [SHAKE, OTHER], [0.01, 0.1])
    risk.to_netcdf(tmp_path / "risk.nc", engine="h5netcdf")
    xr.testing.assert_equal(xr.load_dataset(tmp_path / "risk.nc"), risk)


# --------------------------------------------------------------------------- draws without a response


def test_impossible_draws_are_left_out_and_counted():
    """A negative stiffness is refused by the structure; one of 1e300 has no response."""
    k = np.ones((2, 4)) * [[1.0], [1.2]]
    possible = posterior_response(posterior(k=k), chain, SHAKE, "base_shear")
    k = np.concatenate([k, [[-1.0], [1e300]]], axis=1)
    k[0, 1] = np.nan
    left_out = pmf.exceptions.PredictionWarning
    with pytest.warns(left_out, match=r"3 of 10 draws have no response .*out: `stiffness` must"):
        found = posterior_response(posterior(k=k), chain, SHAKE, "base_shear")
    assert (found.attrs["draws_left_out"], found.attrs["draws_used"]) == (3, 7)
    np.testing.assert_array_equal(found["chain"], [0, 0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(found["draw"], [0, 2, 3, 0, 1, 2, 3])
    expected = np.delete(possible["base_shear_peak"].values, 1)
    np.testing.assert_allclose(found["base_shear_peak"], expected, rtol=1e-12)
    assert found["base_shear"].notnull().all()
    with pytest.warns(left_out, match="3 of 10 draws"):
        risk = first_passage_probability(posterior(k=k), chain, SHAKE, 1e-9)
    assert (risk.attrs["draws_left_out"], float(risk["probability_any"])) == (3, 1.0)
    with pytest.warns(left_out, match="1 of 2 draws .* frequencies or damping are not finite"):
        posterior_response(posterior(k=[[1.0, 1e300]]), chain, SHAKE)
    for bad, why in ((-1.0, "none of 2: `stiffness` must be positive"), (1e300, "none of 2. Their freq")):
        with pytest.raises(ValueError, match=f"`structure` must have a response for some draws, got {why}"):
            posterior_response(posterior(k=[[bad, bad]]), chain, SHAKE)


def test_draws_that_fail_to_integrate_are_left_out():
    """One is refused by the structure, one is too stiff to integrate; the warning points to the call."""
    k, left_out = np.array([[1.0, -1.0, 1.1, 1e30, 1.2]]), pmf.exceptions.PredictionWarning
    with pytest.warns(left_out, match="2 of 5 draws .* out: `stiffness` must be pos") as caught:
        found = posterior_response(posterior(k=k), bouc_wen, SHAKE, ["base_shear", "relative_velocity"])
    assert caught[0].filename == __file__
    np.testing.assert_array_equal(found["draw"], [0, 2, 4])
    for name in ("base_shear", "relative_velocity"):
        slow = [pmf.simulate(bouc_wen(v), SHAKE, quantity=name).values for v in (1.0, 1.1, 1.2)]
        assert_bands(found, name, np.stack(slow))
    with pytest.warns(left_out, match="1 of 2 draws .*or their integration fails") as caught:
        first_passage_probability(posterior(k=[[1e30, 1.0]]), bouc_wen, [SHAKE, OTHER], 0.01)
    assert caught[0].filename == __file__
    with pytest.raises(ValueError, match="must have a response for some draws, got none of 1. Their freq"):
        posterior_response(posterior(k=[[1e30]]), bouc_wen, SHAKE)
    rigid = posterior_response(posterior(k=[[1e30, 1.0]]), frame, SHAKE)  # follows the base
    assert rigid.attrs["draws_left_out"] == 0


# --------------------------------------------------------------------------- first passage


def shear_peaks(scale):
    """Mass and stiffness by the same factor: the base shear is proportional to it."""
    return chain(scale, mass=scale * MASS)


def test_first_passage_of_a_proportional_peak():
    """P(c m > limit) of a Normal m in closed form; 4.5 standard errors at five limits."""
    unit = np.abs(slow_history(chain(1.0), SHAKE, "base_shear")).max()
    scale = np.random.default_rng(6).normal(1.0, 0.1, (4, 500))
    limits = unit * np.array([0.85, 0.95, 1.0, 1.1, 1.2])
    found = first_passage_probability(
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


@pytest.mark.parametrize("structure", [chain, frame, bouc_wen, duffing, dashpot])
def test_first_passage_counts_peaks(idata, structure):
    """Of two earthquakes with their own steps; drifts of linear structures are outputs."""
    quantity, asked = "inter_storey_drift", {}
    if structure in (frame, dashpot):
        quantity, asked = "relative_displacement", {"outputs": DRIFTS}
    limits = np.array([0.005, 0.02, 0.03, 0.3])
    found = first_passage_probability(idata, structure, [SHAKE, OTHER], limits, quantity, **asked)
    many = structures_of(idata, structure)
    slow = [[abs(slow_history(s, r, quantity, **asked)).max(axis=-1) for s in many] for r in (SHAKE, OTHER)]
    np.testing.assert_allclose(found["peak"], slow, rtol=1e-10)
    above = np.array(slow)[:, None] > limits[:, None, None]  # (record, limit, sample, row)
    np.testing.assert_allclose(found["record_probability"], above.mean(axis=2))
    np.testing.assert_allclose(found["probability"], above.mean(axis=(0, 2)))
    np.testing.assert_allclose(found["record_probability_any"], above.any(axis=-1).mean(axis=2))
    np.testing.assert_allclose(found["probability_any"], above.any(axis=-1).mean(axis=(0, 2)))
    assert set(found["probability_any"].values[[0, -1]]) == {0.0, 1.0}
    assert (found["probability_se"] > 0.0).all(), "no exceedance among 30 draws is not certain"
    assert found["record_name"].values.tolist() == [SHAKE.name, OTHER.name]
    alone = first_passage_probability(idata, structure, OTHER, 0.02, quantity, **asked)
    np.testing.assert_array_equal(found["record_probability"][1, 1], alone["probability"])
    assert alone.sizes["record"] == 1 and 0.0 < float(alone["probability_any_se"]) < 0.2


def test_first_passage_under_several_loads(idata):
    """Motions of the supports and forces of both kinds in one call, each with its own modal loads."""
    loads = [*LOADS.values(), LOADS["two supports"]]
    found = first_passage_probability(idata, two_supports, loads, 1.0, "base_shear", sensors=[0])
    for i, load in enumerate(loads):
        slow = [slow_history(s, load, "base_shear") for s in structures_of(idata, two_supports)]
        np.testing.assert_allclose(found["peak"][i], np.abs(slow).max(axis=-1), rtol=1e-11)
    assert found["probability"].dims == ("support",)


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
        found = posterior_response(
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
    found = posterior_response(idata, chain, SHAKE, ["absolute_acceleration", "base_shear"])
    measured = pmf.simulate(chain(1.0), SHAKE, sensors=[2], dt=0.04)
    axes = pmf.plots.response(found, "absolute_acceleration", measured=measured)
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
    [again] = pmf.plots.response(
        found, "absolute_acceleration", 1, np.zeros((1, found.sizes["time"])), axes[1]
    )
    assert again is axes[1]
    plots.close(axes[:1])


FIGURE_REFUSES = {  # what is said: what is given
    "`quantity` must be one of absolute_acceleration, base_shear, got 'speed'": {"quantity": "speed"},
    r"`sensors` must be among \[0, 1, 2\], got \[5\]. Predict": {"sensors": [5]},
    "`sensors` must be left out for a base_shear, got 0": {"quantity": "base_shear", "sensors": 0},
    r"`measured` must have shape \(sensor, time\) = \(3, 201\) to match.*\(3, 2\)": {
        "measured": np.zeros((3, 2))
    },
    r"`measured` must have dimensions \(sensor, time\), got \('floor": {
        "measured": pmf.simulate(chain(1.0), SHAKE).rename(sensor="floor")
    },
    "`axes` must be one for each of 3 sensors, got 1": {"axes": [None]},
}


@refusals("arguments", FIGURE_REFUSES)
def test_figure_refuses(idata, arguments, match):
    found = posterior_response(idata, chain, SHAKE, ["absolute_acceleration", "base_shear"])
    with pytest.raises(ValueError, match=match):
        plots.response(**({"result": found, "quantity": "absolute_acceleration"} | arguments))


# --------------------------------------------------------------------------- the border


def test_forms_of_a_posterior(idata):
    for given in (idata, idata["posterior"], idata["posterior"].to_dataset()):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = posterior_response(given, chain, OTHER, "base_shear", draws=4)
        assert found.sizes["sample"] == 4


def test_parameters_the_posterior_lacks_keep_their_default():
    found = posterior_response(posterior(k=[[1.0]]), lambda k, damping=0.2: chain(k, damping), OTHER)
    exact = pmf.simulate(chain(1.0, 0.2), OTHER)
    assert peak_error(found["absolute_acceleration_mean"], exact) < 1e-13


def growing(k):
    return pmf.SpringMassChain(np.ones(1 + int(k > 1)), 1.0, pmf.ModalDamping(0.1))


def of_supports(k):
    return frame(k, SHARE if k > 0.7 else SHARE @ np.ones((2, 1)))


REFUSED_VALUES = {  # what is said: what is given
    "`idata` must be a DataTree with a group `posterior`.* got dict. Pass": {"idata": {"k": 1.0}},
    "`idata` must be .*got Dataset": {"idata": xr.Dataset({"k": 1.0})},
    r"`structure` must have parameters .*\(k\), got theta. Rename": {"structure": lambda theta: 1},
    r"`structure` must have parameters .*\(k\), got none": {"structure": lambda: 1},
    r"the same degrees of freedom for every draw, got \[1, 2\]": {"structure": growing},
    r"the same supports for every draw, got \[1, 2\]. Predict": {"structure": of_supports},
    "`record` must give 1 support accelerations, .* got 2": {
        "record": LOADS["two supports"],
        "structure": frame,
    },
    "`draws` must be an integer of at least 1, got 0": {"draws": 0},
    "`n_modes` must be left out for a nonlinear": {"n_modes": 2, "structure": bouc_wen},
    "`sensors` must be left out with `outputs`, got both": {"outputs": np.eye(3), "sensors": [1]},
}
REFUSED_TYPES = {
    "`structure` must be a function .* got SpringMassChain": {"structure": chain(1.0)},
    "`structure` must return a structure, got float": {"structure": lambda k: 1.0},
    "return a structure of numbers, got PyTensor": {"structure": lambda k: chain(pt.exp(k))},
    "`record` must be a Record, got ndarray": {"record": SHAKE.acceleration},
    "a Record for a SpringMassChain, got L": {"record": LOADS["forces"]},
    "a Record for a DuffingChain, got L": {"record": LOADS["forces"], "structure": duffing},
    "its own or dt, sensors, n_modes, outputs, got 'modes'. Did you mean": {"modes": 2},
}


@refusals("arguments", REFUSED_VALUES, REFUSED_TYPES)
@pytest.mark.parametrize("function", [posterior_response, first_passage_probability])
def test_refusals(function, arguments, error, match):
    given = {"idata": posterior(k=[[0.5, 1.5]]), "structure": chain, "record": SHAKE} | arguments
    if function is first_passage_probability:
        given |= {"limit": 0.1, "quantity": "absolute_acceleration"}
    with pytest.raises(error, match=match):
        function(**given)


REFUSALS_OF_ONE = {  # what is said: what is given, of bands, or of a limit
    r"`quantities` must be of .*base_shear, got \['stress'\]": {"quantities": ["stress"]},
    r"`quantities` must be of .*, got \[\]": {"quantities": []},
    r"`quantiles` must lie between 0 and 1, got \[5, 95\]. Pass": {"quantiles": [5, 95]},
    "`outputs` must be left out for 'base_shear'": {"quantities": ["base_shear"], "outputs": np.eye(3)},
    "`quantity` must be one of .*, got 'drift'": {"limit": 0.1, "quantity": "drift"},
    r"`quantity` must be one of .*, got \['base": {"limit": 0.1, "quantity": ["base_shear"]},
    r"`limit` must be a positive number or .*got \[0.1, -1.0": {"limit": [0.1, -1.0]},
    "`record` must be one Record or several, got none": {"limit": 0.1, "record": []},
    "for a LinearStructure, got 'inter_storey_drift'.*outputs=S": {"limit": 0.1, "structure": frame},
}


@refusals("arguments", REFUSALS_OF_ONE)
def test_refusals_of_one(arguments, match):
    defaults = {"idata": posterior(k=[[0.5, 1.5]]), "structure": chain, "record": SHAKE}
    with pytest.raises(ValueError, match=match):
        (first_passage_probability if "limit" in arguments else posterior_response)(**(defaults | arguments))


def test_every_family_of_draws_is_asked():
    """What fits the first structure need not fit the second."""

    def structure(k):
        return (chain if k < 0.7 else bouc_wen if k < 1.5 else frame)(k)

    with pytest.raises(ValueError, match="for a LinearStructure, got 'inter_storey_drift'"):
        posterior_response(posterior(k=[[0.5, 2.0]]), structure, SHAKE, "inter_storey_drift")
    with pytest.raises(ValueError, match="`n_modes` must be left out for a nonlinear"):
        posterior_response(posterior(k=[[0.5, 1.0]]), structure, SHAKE, n_modes=2)
    with pytest.raises(TypeError, match="`record` must be a Record for a HystereticChain"):
        posterior_response(posterior(k=[[2.0, 1.0]]), structure, LOADS["forces"])
