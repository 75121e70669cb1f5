"""What is said of a fit: of right models nothing bad, of wrong ones what is wrong."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from benchmarks import truth
from pymc_features import (
    HystereticChain,
    ModalDamping,
    Record,
    SpringMassChain,
    simulate,
    synthetic_earthquake,
)
from pymc_features.update import read_problem, run_update, write_example
from pymc_features.update.kinds.responses import Responses, measured_gain, residuals_of
from pymc_features.update.report.document import leans, overlap_of
from support.update_files import replaced

MASS, STIFFNESS = [0.1601, 0.1601, 0.1421], [385.0, 420.0, 600.0]
BUILDING = SpringMassChain(MASS, STIFFNESS, ModalDamping(0.01))
SHAKING = synthetic_earthquake(12.0, 0.01, random_seed=7, pga=3.0)
TIMES = {"time": 0.01 * np.arange(SHAKING.n_times)}


def judged(measured, response, structure, record=SHAKING, low=None, high=None):
    """The verdict on a response, without a posterior behind it."""
    sensors = [f"floor{i}" for i in range(1, len(measured) + 1)]
    channels = xr.DataArray(measured, dims=("sensor", "time"), coords={"sensor": sensors} | TIMES)
    kept = SimpleNamespace(low=low, high=high) if low or high else None
    config = SimpleNamespace(processing=SimpleNamespace(band_pass=kept), cyclic=None)
    responses = Responses(config, record, channels, 0.01, "simulated", [])
    modes = structure.modes()
    dims = ("chain", "draw", "mode")
    bands = xr.DataArray(response[None], dims=("quantile", "sensor", "time"), coords={"quantile": [0.5]})
    relative = np.sqrt(np.square(measured - response).sum(axis=1) / np.square(measured).sum(axis=1))
    bands = xr.Dataset({"response": bands, "normalised_error": ("sensor", relative)}, {"sensor": sensors})
    columns = {"natural_frequency": modes.natural_frequencies, "damping_ratio": modes.damping_ratios}
    part = {
        "posterior": xr.Dataset(),
        "observed_data": xr.Dataset({"y": channels}),
        "bands": bands,
        "modal": xr.Dataset({name: (dims, values[None, None]) for name, values in columns.items()}),
    }
    data = xr.Dataset({"peak_frequency": ("peak", measured_gain(responses)[1])})
    tree = {f"NORM/{name}": dataset for name, dataset in part.items()} | {"data": data}
    return responses.verdict(None, xr.DataTree.from_dict(tree), "NORM")


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.02, 1.0])
def test_of_right_models_nothing_bad_is_said(level):
    """White noise on 40 earthquakes: no word but the first sentence in 38 of them at least.

    If one of 100 right models were accused, one run of 130 would fail.
    """
    alarms = 0
    for seed in range(40):
        record = synthetic_earthquake(12.0, 0.01, random_seed=seed, pga=3.0)
        exact = simulate(BUILDING, record).values
        scale = level * exact.std(axis=1, keepdims=True)
        noise = scale * np.random.default_rng(seed).standard_normal(exact.shape)
        found = judged(exact + noise, exact, BUILDING, record)
        assert found.explains
        assert found.sentences[0].startswith("The model explains the measurements")
        alarms += len(found.sentences) > 1
    assert alarms <= 2


EXACT = simulate(BUILDING, SHAKING).values


def test_inverted_base():
    found = judged(-EXACT, EXACT, BUILDING)
    assert not found.explains
    assert "does not explain floor1, floor2, floor3" in found.sentences[0]
    assert "base, or all sensors, may be inverted" in found.sentences[1]


def test_one_floor_of_another_structure():
    """Only the floor that is not explained is named."""
    other = simulate(SpringMassChain(MASS, [300.0, 420.0, 600.0], ModalDamping(0.01)), SHAKING).values
    measured = np.vstack([EXACT[0], other[1], EXACT[2]])
    measured += 0.02 * np.random.default_rng(0).standard_normal(measured.shape)
    found = judged(measured, EXACT, BUILDING)
    assert found.sentences[0].startswith("This model does not explain floor2:")
    assert "error at floor2 is no noise" in found.sentences[1]


def test_frequencies_outside_the_band_and_odd_damping():
    found = judged(EXACT, EXACT, BUILDING, low=5.0, high=12.0)
    assert any(
        "f1 (3.7 Hz), f3 (16.1 Hz) lie outside the band of the data, 5 to 12 Hz" in s for s in found.sentences
    )
    heavy = SpringMassChain(MASS, STIFFNESS, ModalDamping([0.3, 0.01, 0.01]))
    found = judged(EXACT, EXACT, heavy)
    assert any("beyond what structures have: 30 % at mode 1." in s for s in found.sentences)


def fitted(folder, record, floors, *pairs):
    """The verdict after Laplace's approximation, NORM, of a file with noise of 5 %."""
    path = folder / "fit.toml"
    write_example(path, synthetic=True)
    scale = np.array([0.01, *(0.05 * floors.std(axis=1))])[:, None]
    exact = np.vstack([record.acceleration, floors])
    values = exact + scale * np.random.default_rng(7).standard_normal(exact.shape)
    names = ["time [s]", "base [m/s^2]", *(f"floor{i} [m/s^2]" for i in range(1, len(floors) + 1))]
    table, rows = folder / "fit-measured.csv", np.column_stack([record.time, values.T])
    np.savetxt(table, rows, delimiter=",", header=",".join(names), comments="")
    common = [
        ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["NORM"]'),
        ('method = "auto"', 'method = "laplace"'),
        ("draws = 1000", "draws = 300"),
        ('quantities = ["inter_storey_drift", "base_shear"]', "quantities = []"),
    ]
    path.write_text(replaced(path.read_text(), [*common, *pairs]))
    problem = read_problem(path)
    result = run_update(problem, progressbar=False)
    return problem.verdict(result, problem.reported[0])


@pytest.mark.slow
def test_fits_of_right_and_wrong_models(tmp_path):
    """A yielding chain, a storey that the model lacks and a base taken as straight lines are named.

    Straight lines lack 8 % of modes up to 16 Hz at 100 Hz. Of the right model nothing is said.
    """

    def told(name, record, floors, *pairs):
        folder = tmp_path / name
        folder.mkdir()
        return fitted(folder, record, floors, *pairs)

    motion, parts = truth.motion(100.0, 12.0, 11, top=0.4), BUILDING.matrices()._asdict()
    exact = truth.response(truth.Linear(**parts, influence=np.ones((3, 1))), motion)
    data = Record(motion.values()[0], 0.01), exact["absolute_acceleration"]
    assert len(told("right", *data).sentences) == 1
    sensors = 'sensors = ["floor1", "floor2", "floor3"]'
    found = told("linear", *data, (sensors, f'{sensors}\ninterpolation = "linear"'))
    assert not found.explains
    assert any('Set interpolation = "band-limited".' in sentence for sentence in found.sentences)
    drift = np.abs(simulate(BUILDING, SHAKING, quantity="inter_storey_drift").values).max()
    yields = {"yield_displacement": 0.25 * drift, "post_yield_ratio": 0.1}
    yielding = HystereticChain(MASS, STIFFNESS, ModalDamping(0.01), **yields)
    found = told("yields", SHAKING, simulate(yielding, SHAKING).values)
    assert not found.explains
    assert any("springs yield" in sentence for sentence in found.sentences)
    found = told(
        "lacks",
        SHAKING,
        EXACT[[0, 2]],
        (sensors, 'sensors = ["floor1", "floor2"]'),
        ("mass = [0.1601, 0.1601, 0.1421]", "mass = [0.1601, 0.1421]"),
        ('stiffness = ["k1", "k2", "k3"]', 'stiffness = ["k1", "k2"]'),
        ("k3 = {", "# k3 = {"),
    )
    assert found.sentences[0].startswith("This model does not explain floor1:")
    assert any("a peak at 16.2 Hz" in sentence for sentence in found.sentences)


def test_what_sensors_cannot_tell_is_said_before(tmp_path):
    path = tmp_path / "few.toml"
    write_example(path, synthetic=True)
    problem = read_problem(path)
    told = problem.first.foretold(problem)
    assert [sentence.split(":")[0] for sentence in told] == [
        "TN counts 3 observations for 4 unknown parameters of the structure",
        "EXP counts 6 observations for 4 unknown parameters of the structure",
    ]


def test_overlap_against_the_closed_form():
    """Of two Gaussians a distance of d apart: 2 Phi(-d / 2). Of equal ones: nearly one."""
    rng = np.random.default_rng(0)
    prior = rng.standard_normal(40_000)
    for distance in (0.0, 0.5, 2.0):
        found = overlap_of(prior, distance + rng.standard_normal(40_000))
        assert found == pytest.approx(2.0 * stats.norm.cdf(-distance / 2.0), abs=0.02)


LEANS = {
    "a scale far below its prior's": (stats.halfnorm(), 0.003, 1e-4, False),
    "a scale that may be zero": (stats.halfnorm(), 0.003, 0.003, True),
    "a scale beyond what was expected": (stats.halfnorm(), 3.0, 0.01, True),
    "inside bounds": (stats.uniform(), 0.007, 1e-4, False),
    "at a bound": (stats.uniform(), 0.995, 0.003, True),
    "in a tail": (stats.norm(), -2.7, 0.01, True),
    "in a long tail": (stats.lognorm(0.3), 2.2, 0.01, True),
    "in the lower tail of a wide one": (stats.lognorm(1.0), 0.075, 1e-4, True),
    "in the middle": (stats.norm(), 0.5, 1.0, False),
}


@pytest.mark.parametrize("prior, middle, deviation, expected", LEANS.values(), ids=LEANS)
def test_which_posteriors_lean_on_the_edge_of_the_prior(prior, middle, deviation, expected):
    """Of 4,000 draws, as the command has them, by ten seeds."""
    found = [leans(prior.rvs(4000, random_state=seed), middle, deviation) for seed in range(10)]
    assert found == [expected] * 10


@pytest.mark.parametrize("size", [40, 600])
def test_short_records_and_still_bases_raise_no_warning(size):
    rng = np.random.default_rng(0)
    values = rng.standard_normal((2, size))
    base = np.zeros(size) if size == 600 else rng.standard_normal(size)
    measured = SimpleNamespace(step=0.01, motion=base, channels=xr.DataArray(values))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = residuals_of(measured, 0.1 * values, np.array([3.0, 9.0]))
    np.testing.assert_allclose(found.left, 0.01)
    assert np.isfinite(found.coherence).all()
