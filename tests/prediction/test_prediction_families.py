"""Bands and first passages of linear structures, coupled damping and nonlinear chains, draw by draw."""

import tempfile
import tracemalloc
import warnings

import numpy as np
import pytest
import xarray as xr

import pymc_features as pmf
from pymc_features import plots
from pymc_features.prediction import ensemble, histories, simulated
from support.refusals import refusals

SHAKE = pmf.synthetic_earthquake(4.0, 0.02, random_seed=5, pga=3.0)
OTHER = pmf.synthetic_earthquake(3.0, 0.01, random_seed=8, pga=2.0)
RAYLEIGH = pmf.RayleighDamping(0.3, 2e-3)
MASS = np.array([3.0, 2.0, 1.0])
LINEAR = ("absolute_acceleration", "relative_acceleration", "relative_velocity", "relative_displacement")
DRIFTS = np.eye(3) - np.eye(3, k=-1)
SHARE = np.array([[0.9, 0.1], [0.6, 0.4], [0.2, 0.8]])


def chain(k):
    return pmf.SpringMassChain(MASS, 400.0 * k, RAYLEIGH)


def frame(k):
    """The same chain by its matrices."""
    mass, _, stiffness = chain(k).matrices()
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=RAYLEIGH)


def dashpot(k):
    """With a dashpot at the top that couples the modes."""
    mass, damping, stiffness = chain(k).matrices()
    damping[2, 2] += 2.0
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=damping)


def two_supports(k):
    mass, damping, stiffness = chain(k).matrices()
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=damping, influence=SHARE)


def without_top_mass(k):
    """The top has no mass and follows the floor below."""
    mass, _, stiffness = chain(k).matrices()
    mass[2, 2] = 0.0
    return pmf.LinearStructure(mass, stiffness=stiffness, damping=RAYLEIGH)


def bouc_wen(k):
    return pmf.HystereticChain(MASS, 400.0 * k, RAYLEIGH, yield_displacement=0.01, post_yield_ratio=0.1)


def duffing(k):
    return pmf.DuffingChain(MASS, 400.0 * k, RAYLEIGH, cubic=2e5)


def posterior(k):
    return xr.Dataset({"k": (("chain", "draw", "spring")[: np.ndim(k)], np.asarray(k, dtype=float))})


@pytest.fixture(scope="module")
def idata():
    """Two chains of 15 draws of three springs."""
    return posterior(np.exp(0.3 * np.random.default_rng(1).normal(size=(2, 15, 3))))


def draws_of(idata):
    return idata["k"].values.reshape(-1, *idata["k"].shape[2:])


def assert_bands(found, name, slow, tolerance=1e-12):
    """Bands, mean and peaks of a quantity against those of all histories (sample, ..., time)."""
    expected = {
        name: np.quantile(slow, found["quantile"], axis=0),
        f"{name}_mean": slow.mean(axis=0),
        f"{name}_peak": np.abs(slow).max(axis=-1),
    }
    for key, values in expected.items():
        assert found[key].shape == values.shape, key
        atol = tolerance * np.abs(slow).max()
        np.testing.assert_allclose(found[key], values, rtol=0, atol=atol, err_msg=key)


# --------------------------------------------------------------------------- linear structures


@pytest.mark.parametrize(
    ("record", "dt", "n_modes"), [(SHAKE, None, None), (SHAKE, 0.01, 2), (OTHER, 0.02, 1)]
)
def test_bands_of_a_chain_by_its_matrices(idata, record, dt, n_modes):
    """All quantities; drifts by `outputs`."""
    settings = {"dt": dt, "n_modes": n_modes}
    names = [*LINEAR, "base_shear"]
    expected = pmf.posterior_response(idata, chain, record, [*names, "inter_storey_drift"], **settings)
    found = pmf.posterior_response(idata, frame, record, names, **settings)
    for key in found.data_vars:
        atol = 1e-12 * np.abs(expected[key]).max()
        xr.testing.assert_allclose(found[key], expected[key], rtol=0, atol=float(atol))
        assert found[key].attrs == expected[key].attrs
    for structure in (frame, chain):
        drift = pmf.posterior_response(
            idata, structure, record, "relative_displacement", outputs=DRIFTS[[2, 0]], **settings
        )
        assert drift["sensor"].attrs["long_name"] == "row of outputs"
        for key in ("", "_mean", "_peak"):
            np.testing.assert_allclose(
                drift[f"relative_displacement{key}"],
                expected[f"inter_storey_drift{key}"].sel(storey=[2, 0]),
                rtol=0,
                atol=1e-14,
            )


LOADS = {
    "two supports": pmf.Loading(np.random.default_rng(2).normal(size=(2, 80)), 0.02, name="two"),
    "forces": pmf.Loading(
        np.random.default_rng(3).normal(size=(2, 80)), 0.02, kind="force", matrix=[[1, 0], [0, 2], [3, -1]]
    ),
    "nodal forces": pmf.Loading(np.random.default_rng(4).normal(size=(3, 80)), 0.02, kind="force"),
}


@pytest.mark.slow
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize(("dt", "n_modes"), [(None, None), (0.01, 2)])
def test_several_supports_and_forces(idata, load, dt, n_modes):
    settings = {"dt": dt, "n_modes": n_modes}
    found = pmf.posterior_response(
        idata, two_supports, LOADS[load], [*LINEAR, "base_shear"], **settings, quantiles=[0.1, 0.5]
    )
    assert found["base_shear"].dims == ("quantile", "support", "time")
    for name in [*LINEAR, "base_shear"]:
        slow = [
            pmf.simulate(two_supports(k), LOADS[load], quantity=name, **settings).values
            for k in draws_of(idata)
        ]
        assert_bands(found, name, np.stack(slow))
    axes = pmf.plot_response_bands(found, "base_shear")
    assert axes[1].get_title() == "base shear, support 1"
    plots.close(axes)


def test_what_has_no_mass(idata):
    """Bands under the base's motion; under a force where no mass is, of the others and of the base shear."""
    found = pmf.posterior_response(idata, without_top_mass, SHAKE, LINEAR)
    for name in LINEAR:
        slow = [pmf.simulate(without_top_mass(k), SHAKE, quantity=name).values for k in draws_of(idata)]
        assert_bands(found, name, np.stack(slow))
    push = pmf.Loading(SHAKE.acceleration, SHAKE.dt, kind="force", matrix=[[0.0], [0.0], [1.0]])
    pmf.posterior_response(idata, without_top_mass, push, "base_shear")
    pmf.posterior_response(idata, without_top_mass, push, sensors=[0, 1])
    with pytest.raises(ValueError, match="`sensors` must lie on mass"):
        pmf.posterior_response(idata, without_top_mass, push)


def test_first_passage_under_several_loads(idata):
    """Motions of the supports and forces of both kinds in one call, each with its own modal loads."""
    loads = [*LOADS.values(), LOADS["two supports"]]
    found = pmf.first_passage_probability(idata, two_supports, loads, 1.0, "base_shear", sensors=[0])
    for i, load in enumerate(loads):
        slow = [
            np.abs(pmf.simulate(two_supports(k), load, quantity="base_shear")).max("time")
            for k in draws_of(idata)
        ]
        np.testing.assert_allclose(found["peak"][i], slow, rtol=1e-11)
    assert found["probability"].dims == ("support",)
    np.testing.assert_array_equal(found["peak"][3], found["peak"][0])


# --------------------------------------------------------------------------- draw by draw


@pytest.mark.slow
@pytest.mark.parametrize("structure", [dashpot, bouc_wen, duffing], ids=lambda f: f.__name__)
@pytest.mark.parametrize("memory", [histories.MEMORY, 8 * 30 * 3 * 7, 1])
def test_simulated_bands_are_those_of_all_histories(idata, structure, memory, monkeypatch):
    """In memory, in blocks of 7 samples on disk, and of one."""
    monkeypatch.setattr(histories, "MEMORY", memory)
    dt = 0.04 if memory == 1 else 0.01
    names = ["absolute_acceleration", "relative_displacement", "base_shear"]
    names += [] if structure is dashpot else ["inter_storey_drift"]
    found = pmf.posterior_response(idata, structure, SHAKE, names, dt=dt, sensors=[2, 0])
    for name in names:
        sensors = None if name == "base_shear" else [2, 0]
        slow = [
            pmf.simulate(structure(k), SHAKE, quantity=name, dt=dt, sensors=sensors).values
            for k in draws_of(idata)
        ]
        assert_bands(found, name, np.stack(slow))
    np.testing.assert_allclose(found["time"], np.arange(found.sizes["time"]) * dt, atol=1e-12)


@pytest.mark.parametrize("structure", [dashpot, bouc_wen], ids=lambda f: f.__name__)
def test_combinations_of_simulated_structures(idata, structure):
    found = pmf.posterior_response(idata, structure, OTHER, "relative_velocity", outputs=DRIFTS[1:])
    slow = [
        pmf.simulate(structure(k), OTHER, quantity="relative_velocity", outputs=DRIFTS[1:]).values
        for k in draws_of(idata)
    ]
    assert_bands(found, "relative_velocity", np.stack(slow))


def test_truncated_coupled_modes(idata):
    found = pmf.posterior_response(idata, dashpot, SHAKE, n_modes=2)
    slow = [pmf.simulate(dashpot(k), SHAKE, n_modes=2).values for k in draws_of(idata)]
    assert_bands(found, "absolute_acceleration", np.stack(slow))


@pytest.mark.parametrize("memory", [histories.MEMORY, 8 * 30 * 3 * 7])
def test_draws_of_several_kinds_keep_their_order(idata, memory, monkeypatch):
    """Chains, modes, coupled damping and Bouc-Wen springs in turn."""
    monkeypatch.setattr(histories, "MEMORY", memory)
    kinds = (chain, dashpot, frame, bouc_wen)

    def structure(k):
        return kinds[int(1e6 * k[0]) % 4](k)

    assert len({structure(k).family for k in draws_of(idata)}) == 3
    found = pmf.posterior_response(idata, structure, SHAKE, ["relative_velocity", "base_shear"])
    for name in ("relative_velocity", "base_shear"):
        slow = [pmf.simulate(structure(k), SHAKE, quantity=name).values for k in draws_of(idata)]
        assert_bands(found, name, np.stack(slow))
    peaks = pmf.first_passage_probability(idata, structure, SHAKE, 1.0, "base_shear")["peak"]
    np.testing.assert_allclose(peaks[0], np.abs(slow).max(axis=-1), rtol=1e-10)


@pytest.mark.parametrize("structure", [bouc_wen, duffing, dashpot], ids=lambda f: f.__name__)
def test_first_passage_counts_peaks(idata, structure):
    """Of two earthquakes with their own steps, without keeping histories."""
    quantity, asked = "inter_storey_drift", {}
    if structure is dashpot:
        quantity, asked = "relative_displacement", {"outputs": DRIFTS}
    limits = np.array([0.01, 0.02, 0.03])
    found = pmf.first_passage_probability(idata, structure, [SHAKE, OTHER], limits, quantity, **asked)
    slow = np.array(
        [
            [
                np.abs(pmf.simulate(structure(k), r, quantity=quantity, **asked)).max("time")
                for k in draws_of(idata)
            ]
            for r in (SHAKE, OTHER)
        ]
    )
    np.testing.assert_allclose(found["peak"], slow, rtol=1e-10)
    above = slow[:, None] > limits[:, None, None]  # (record, limit, sample, row)
    np.testing.assert_allclose(found["record_probability"], above.mean(axis=2))
    np.testing.assert_allclose(found["probability_any"], above.any(axis=-1).mean(axis=(0, 2)))
    assert 0.0 < float(found["probability_any"][1]) < 1.0


# --------------------------------------------------------------------------- memory and files


@pytest.mark.slow
def test_memory_is_bounded(monkeypatch):
    """Four tenths of what the histories take, 11 MB, with blocks of 1 MiB."""
    monkeypatch.setattr(histories, "MEMORY", 2**20)
    record = pmf.synthetic_earthquake(30.0, 0.02, random_seed=1, pga=3.0)
    many = posterior(np.ones((1, 300, 3)) + np.random.default_rng(0).uniform(0.0, 0.2, (1, 300, 3)))
    pmf.posterior_response(many, dashpot, record, draws=4)  # compilation
    tracemalloc.start()
    try:
        found = pmf.posterior_response(many, dashpot, record)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    histories_of_all = 8 * 300 * 3 * found.sizes["time"]
    assert histories_of_all > 10e6
    assert peak < 0.4 * histories_of_all


@pytest.mark.parametrize("fails", [False, True])
def test_files_are_closed(idata, fails, monkeypatch):
    files = []

    def opened(**settings):
        files.append(tempfile.SpooledTemporaryFile(**settings))  # noqa: SIM115
        return files[-1]

    def broken(k):
        if len(files) > 0 and fails:
            raise RuntimeError("no structure")
        return bouc_wen(k)

    monkeypatch.setattr("pymc_features.prediction.simulated.SpooledTemporaryFile", opened)
    names = ["base_shear", "relative_velocity"]
    if fails:
        with pytest.raises(RuntimeError, match="no structure"):
            pmf.posterior_response(idata, broken, SHAKE, names)
    else:
        pmf.posterior_response(idata, broken, SHAKE, names)
    assert len(files) == 2 and all(file.closed for file in files)
    pmf.first_passage_probability(idata, bouc_wen, SHAKE, 0.01)
    assert len(files) == 2, "peaks need no file"


def test_a_nonlinear_chain_is_integrated_once(idata, monkeypatch):
    counted = []
    inner = simulated.nonlinear_histories
    monkeypatch.setattr(simulated, "nonlinear_histories", lambda *a: counted.append(a) or inner(*a))
    names = ["absolute_acceleration", "base_shear", "inter_storey_drift", "relative_displacement"]
    pmf.posterior_response(idata, bouc_wen, OTHER, names, draws=6)
    assert len(counted) == 6


# --------------------------------------------------------------------------- draws without a response


def test_draws_that_fail_to_integrate_are_left_out():
    """One is refused by the structure, one is too stiff to integrate; the warning points to the call."""
    k = np.array([[1.0, -1.0, 1.1, 1e30, 1.2]])
    with pytest.warns(
        pmf.exceptions.PredictionWarning, match="2 of 5 draws .* out: `stiffness` must be pos"
    ) as caught:
        found = pmf.posterior_response(posterior(k), bouc_wen, SHAKE, ["base_shear", "relative_velocity"])
    assert caught[0].filename == __file__
    np.testing.assert_array_equal(found["draw"], [0, 2, 4])
    for name in ("base_shear", "relative_velocity"):
        slow = [pmf.simulate(bouc_wen(v), SHAKE, quantity=name).values for v in (1.0, 1.1, 1.2)]
        assert_bands(found, name, np.stack(slow))
    with pytest.warns(
        pmf.exceptions.PredictionWarning, match="1 of 2 draws .*or their integration fails"
    ) as caught:
        pmf.first_passage_probability(posterior([[1e30, 1.0]]), bouc_wen, [SHAKE, OTHER], 0.01)
    assert caught[0].filename == __file__
    with pytest.raises(ValueError, match="must have a response for some draws, got none of 1. Their freq"):
        pmf.posterior_response(posterior([[1e30]]), bouc_wen, SHAKE)
    rigid = pmf.posterior_response(posterior([[1e30, 1.0]]), frame, SHAKE)  # follows the base
    assert rigid.attrs["draws_left_out"] == 0


# --------------------------------------------------------------------------- the border


def of_supports(k):
    influence = SHARE if k > 0.7 else SHARE @ np.ones((2, 1))
    return pmf.LinearStructure(MASS, stiffness=frame(k).stiffness, damping=RAYLEIGH, influence=influence)


REFUSED_VALUES = {  # what is said: what is given
    r"the same supports for every draw, got \[1, 2\]. Predict": {"structure": of_supports},
    "`record` must give 1 support accelerations, .* got 2": {"record": LOADS["two supports"]},
    "`n_modes` must be left out for a nonlinear": {"n_modes": 2, "structure": bouc_wen},
    r"`outputs` must have shape \(s, 3\), got \(2, 2\)": {"outputs": np.eye(2)},
    "`sensors` must be left out with `outputs`, got both": {"outputs": np.eye(3), "sensors": [1]},
}
REFUSED_TYPES = {
    "a Record for a SpringMassChain, got L": {"record": LOADS["forces"], "structure": chain},
    "a Record for a DuffingChain, got L": {"record": LOADS["forces"], "structure": duffing},
}


@refusals("arguments", REFUSED_VALUES, REFUSED_TYPES)
@pytest.mark.parametrize("function", [pmf.posterior_response, pmf.first_passage_probability])
def test_refusals(function, arguments, error, match):
    given = {"idata": posterior([[0.5, 0.9]]), "structure": frame, "record": SHAKE} | arguments
    if function is pmf.first_passage_probability:
        given |= {"limit": 0.1, "quantity": "absolute_acceleration"}
    with pytest.raises(error, match=match):
        function(**given)


def test_drifts_of_linear_structures_are_outputs():
    with pytest.raises(ValueError, match="for a LinearStructure, got 'inter_storey_drift'.*outputs=S"):
        pmf.first_passage_probability(posterior([[1.0]]), frame, SHAKE, 0.01)
    with pytest.raises(ValueError, match="`outputs` must be left out for 'base_shear'"):
        pmf.posterior_response(
            posterior([[1.0]]), chain, SHAKE, ["relative_velocity", "base_shear"], outputs=np.eye(3)
        )


def test_every_family_of_draws_is_asked():
    """What fits the first structure need not fit the second."""

    def structure(k):
        return (chain if k < 0.7 else bouc_wen if k < 1.5 else frame)(k)

    with pytest.raises(ValueError, match="for a LinearStructure, got 'inter_storey_drift'"):
        pmf.posterior_response(posterior([[0.5, 2.0]]), structure, SHAKE, "inter_storey_drift")
    with pytest.raises(ValueError, match="`n_modes` must be left out for a nonlinear"):
        pmf.posterior_response(posterior([[0.5, 1.0]]), structure, SHAKE, n_modes=2)
    with pytest.raises(TypeError, match="`record` must be a Record for a HystereticChain"):
        pmf.posterior_response(posterior([[2.0, 1.0]]), structure, LOADS["forces"])


def test_coupled_draws_are_told_from_classical_ones(idata):
    """A damping matrix that the modes diagonalise is marched, not simulated."""
    kinds = {structure: ensemble.kind_of(structure(1.0), 3) for structure in (frame, two_supports, dashpot)}
    assert kinds == {
        frame: ensemble.Oscillators,
        two_supports: ensemble.Oscillators,
        dashpot: ensemble.Simulated,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pmf.posterior_response(idata, two_supports, LOADS["two supports"], "base_shear", draws=2)
