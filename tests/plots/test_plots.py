"""Figures show what the result holds."""

import numpy as np
import pytest
import xarray as xr

from pymc_features import Loading, Record, plots


@pytest.fixture
def result():
    """A made-up result with two likelihoods and three steps."""
    statistics = np.array([1.0, 0.8, 1.05, 1.3])
    values = np.broadcast_to(statistics, (2, 3, 2, 4)).copy()
    values[1, :, 1] = np.nan
    dims = ("likelihood", "multiplier", "parameter", "statistic")
    coords = {
        "likelihood": ["EXP", "ABC"],
        "multiplier": [0.1, 1.0, 10.0],
        "parameter": ["theta", "sigma"],
        "statistic": ["map", "q05", "q50", "q95"],
    }
    summary = xr.Dataset({"sampled": (dims, values), "exact": (dims, values + 0.01)}, coords=coords)
    data = xr.Dataset(
        {"ground_acceleration": ("record_time", [0.0, -2.0, 1.0])},
        coords={"record_time": [0.0, 0.1, 0.2]},
        attrs={"record": "pulse"},
    )
    return xr.DataTree.from_dict({"/summary": summary, "/data": data})


def test_record_figure(result):
    record = Record([0.0, -2.0, 1.0], 0.1, name="pulse")
    [ax] = plots.record(record)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [0.0, -2.0, 1.0])
    assert ax.lines[1].get_xydata().tolist() == [[0.1, -2.0]]
    assert (ax.get_xlabel(), ax.get_title()) == ("time [s]", "pulse")
    [same] = plots.record(result, axes=ax)  # the record of a study
    assert same is ax
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), ax.lines[3].get_xydata())
    loading = Loading([[0.0, 5.0, 0.0], [1.0, 0.0, 2.0]], dt=0.1, kind="force", name="hammer")
    [ax] = plots.record(loading)
    assert [list(line.get_ydata()) for line in ax.lines[:2]] == loading.values.tolist()
    assert (ax.get_ylabel(), ax.get_title()) == ("force [N]", "hammer")
    with pytest.raises(TypeError, match="`record` must be a Record, a Loading or the result .*, got ndarray"):
        plots.record(record.acceleration)
    with pytest.raises(ValueError, match="`record` must hold the ground acceleration in a group `data`"):
        plots.record(xr.DataTree())
    with pytest.raises(ValueError, match="`axes` must be one, got 2"):
        plots.record(record, [ax, ax])


@pytest.fixture
def loops(result):
    """The made-up result with loops of four springs."""
    drift = np.outer([2.0, 0.5, 4.0, 3.0], [0.0, 1.0, -1.0])
    result["loops"] = xr.Dataset(
        {
            "drift": (("spring", "time"), 1e-3 * drift),
            "force": (("spring", "time"), 10.0 * drift),
            "yield_displacement": ("spring", np.full(4, 1e-3)),
            "ductility": ("spring", [2.0, 0.5, 4.0, 3.0]),
        },
        coords={"spring": range(4), "time": [0.0, 0.1, 0.2]},
        attrs={"record": "pulse"},
    )
    result.attrs["title"] = "Bouc-Wen chain"
    return result


def test_loops_figure(loops):
    axes = plots.loops(loops)
    assert [ax.get_title() for ax in axes] == [
        f"spring {i}: ductility {d}" for i, d in ((2, 4), (3, 3), (0, 2))
    ]
    np.testing.assert_allclose(axes[0].lines[0].get_xydata(), [[0, 0], [4, 40], [-4, -40]])
    assert [line.get_xdata()[0] for line in axes[0].lines[1:]] == [-1.0, 1.0]
    assert axes[0].figure.get_suptitle() == "Bouc-Wen chain, pulse"
    [ax] = plots.loops(loops, springs=1, axes=axes[2])
    assert ax.get_title() == "spring 1: ductility 0.5"
    axes = plots.sampling_rate(loops, ["EXP", "ABC"])
    assert axes[0].figure.get_suptitle() == "EXP and ABC, Bouc-Wen chain"
    assert plots.widths(loops)[0].get_title() == "Bouc-Wen chain"
    with pytest.raises(ValueError, match=r"`springs` must be among \[0, 1, 2, 3\], got \[7\]"):
        plots.loops(loops, springs=7)
    with pytest.raises(ValueError, match="`axes` must be one for each of 2 springs, got 1"):
        plots.loops(loops, springs=[0, 1], axes=ax)
    with pytest.raises(ValueError, match="`result` must be of a structure whose springs can yield"):
        plots.loops(xr.DataTree())


def test_tolerance_figure():
    result = xr.Dataset(
        {
            "theta": (("epsilon", "quantile"), [[0.5, 1.0, 1.5], [0.9, 1.0, 1.1]]),
            "log_probability": ("epsilon", [-1.0, -3.0]),
        },
        coords={"epsilon": [1.0, 0.1], "quantile": [0.05, 0.5, 0.95]},
    )
    [ax] = plots.tolerance(result)
    assert ax.lines[0].get_xydata().tolist() == [[1.0, 1.0], [0.1, 1.0]]
    band = ax.collections[0].get_paths()[0].vertices
    assert {(1.0, 0.5), (1.0, 1.5), (0.1, 0.9), (0.1, 1.1)} <= set(map(tuple, band))
    assert (ax.get_ylabel(), ax.get_xscale()) == ("theta", "log")
    assert plots.tolerance(result, axes=[ax])[0] is ax
    with pytest.raises(ValueError, match="`result` must have a scalar parameter, got none"):
        plots.tolerance(result[["log_probability"]])


def test_widths_figure(result):
    [ax] = plots.widths(result)
    exact, sampled = ax.lines[0].get_xydata(), ax.lines[1].get_xydata()
    np.testing.assert_allclose(exact, [[0.1, 0.5], [1.0, 0.5], [10.0, 0.5]])
    np.testing.assert_allclose(sampled, exact)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["EXP", "ABC"]
    assert plots.widths(result, ax)[0] is ax


def test_sampling_rate_figure(result):
    axes = plots.sampling_rate(result, ["EXP", "ABC"])
    assert axes.shape == (2,)
    theta, sigma = axes
    assert len(theta.containers) == 2
    assert len(sigma.containers) == 1  # ABC has no sigma
    bars = theta.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose([s[:, 1] for s in bars], [[0.8, 1.3]] * 3)
    assert [t.get_text() for t in theta.get_xticklabels()] == ["0.1", "1", "10"]
    assert "σ [m/s²]" in sigma.get_ylabel()
    axes = plots.sampling_rate(result, ["EXP", "ABC"], parameters=["sigma", "theta"])
    labels = [text.get_text() for text in axes[0].figure.legends[0].get_texts()]
    assert "ABC, sampled" in labels  # whichever panel is the first
    with pytest.raises(ValueError, match=r"`likelihoods` must be among \['EXP', 'ABC'\], got \['TN'\]"):
        plots.sampling_rate(result, "TN")


def test_sampling_rate_figure_of_one_parameter(result):
    """Likelihoods share the axes; bars stand beside each other, in the order that was asked for."""
    result["summary"]["sampled"].loc[{"likelihood": "ABC"}] = [0.9, 0.7, 0.95, 1.2]
    result["summary"]["exact"].loc[{"likelihood": "ABC"}] = [0.9, 0.7, 0.95, 1.2]
    [ax] = plots.sampling_rate(result, ["ABC", "EXP"], parameters="sigma")
    bars = [np.array(bar.lines[2][0].get_segments()) for bar in ax.containers]
    np.testing.assert_allclose(bars[0][:, :, 1], [[0.7, 1.2]] * 3)
    np.testing.assert_allclose(bars[1][:, :, 1], [[0.8, 1.3]] * 3)
    steps = np.array([0.1, 1.0, 10.0])
    assert (bars[0][:, 0, 0] < steps).all() and (bars[1][:, 0, 0] > steps).all()
    areas = [area.get_paths()[0].vertices[:, 1] for area in ax.collections if area.get_paths()]
    ends = {(round(float(area.min()), 9), round(float(area.max()), 9)) for area in areas}
    assert {(0.7, 1.2), (0.81, 1.31)} <= ends
    labels = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert labels[:2] == ["ABC, sampled", "EXP, sampled"]
    with pytest.raises(ValueError, match=r"`parameters` must be among \['theta', 'sigma'\], got \['tau'\]"):
        plots.sampling_rate(result, "EXP", parameters="tau")


@pytest.fixture
def updated():
    """A made-up likelihood of an update: two chains, two sensors."""
    rng = np.random.default_rng(5)
    time, quantile, sensor = 0.1 * np.arange(30), [0.05, 0.5, 0.95], ["floor1", "floor2"]
    middle, around = np.sin(np.arange(60.0)).reshape(2, 30), np.array([-0.1, 0.0, 0.1])[:, None, None]
    coords, dims = {"quantile": quantile, "sensor": sensor, "time": time}, ("quantile", "sensor", "time")
    bands = {
        "response": (dims, middle + around),
        "predictive": (dims, middle + 3.0 * around),
        "normalised_error": ("sensor", [0.25, 0.5]),
    }
    stats = {
        "beta": (("chain", "stage"), [[0.1, 1.0, np.nan], [0.05, 0.5, 1.0]]),
        "accept_rate": (("chain", "stage"), [[0.3, 0.4, np.nan], [0.5, 0.4, 0.3]]),
    }
    parts = {
        "posterior": xr.Dataset({"k": (("chain", "draw"), rng.normal(4.0, 1.0, (2, 50)))}),
        "prior": xr.Dataset({"k": (("chain", "draw"), rng.normal(0.0, 5.0, (1, 400)))}),
        "sample_stats": xr.Dataset(stats, coords={"chain": [0, 1]}),
        "observed_data": xr.Dataset({"y": (dims[1:], middle + 0.2)}, coords={"sensor": sensor, "time": time}),
        "bands": xr.Dataset(bands, coords=coords),
    }
    return xr.DataTree.from_dict(parts)


def test_predictive_figure(updated):
    axes = plots.predictive(updated)
    assert [ax.get_title() for ax in axes] == [
        f"floor{i}: rms error of the median {p} % of the measured rms" for i, p in ((1, 25), (2, 50))
    ]
    lines = {line.get_label(): line.get_ydata() for line in axes[1].lines}
    bands = updated["bands"].to_dataset()
    np.testing.assert_array_equal(lines["median response"], bands["response"].values[1, 1])
    np.testing.assert_allclose(lines["measured"] - lines["median response"], 0.2)
    widths = {p.get_label(): np.ptp(p.get_paths()[0].vertices[:, 1]) for p in axes[0].collections}
    span = np.ptp(bands["response"].values[1, 0])
    assert widths == pytest.approx({"predictive, 90 %": span + 0.6, "response, 90 %": span + 0.2})
    [ax] = plots.predictive(updated, "floor2", window=(0.95, 2.05), axes=axes[1])
    assert ax.lines[-1].get_xdata()[[0, -1]] == pytest.approx([1.0, 2.0])
    with pytest.raises(ValueError, match=r"`sensors` must be among \['floor1', 'floor2'\], got \['roof'\]"):
        plots.predictive(updated, "roof")
    with pytest.raises(ValueError, match="`window` must hold samples"):
        plots.predictive(updated, window=(50.0, 60.0))
    with pytest.raises(ValueError, match="`axes` must be one for each of 2 sensors, got 1"):
        plots.predictive(updated, axes=ax)


def test_tempering_figure(updated):
    axes = plots.tempering(updated)
    assert [line.get_label() for line in axes[0].lines] == ["chain 0", "chain 1"]
    np.testing.assert_array_equal(axes[0].lines[1].get_xydata(), [[1, 0.05], [2, 0.5], [3, 1.0]])
    assert axes[0].get_ylabel() == "inverse temperature β [-]"
    np.testing.assert_array_equal(axes[1].lines[0].get_ydata(), [0.3, 0.4, np.nan])
    with pytest.raises(ValueError, match="`idata` must be of a sampler with stages, got none"):
        plots.tempering(xr.DataTree())


def test_prior_posterior_figure(updated):
    [ax] = plots.prior_posterior(updated, units={"k": "N/m^2"})
    label, beyond = ax.get_xlabel().splitlines()
    low, high = np.quantile(updated["prior"]["k"], [0.005, 0.995])
    assert label == "k [N/m²]" and beyond == f"prior {low:.3g} to {high:.3g}"
    first, last = np.quantile(updated["posterior"]["k"], [0.001, 0.999])
    left, right = ax.get_xlim()  # a quarter of the axis at least is the posterior's
    assert low <= left < first < last < right <= high and right - left < 4.001 * (last - first)
    assert [text.get_text() for text in ax.figure.legends[0].get_texts()] == ["prior", "posterior"]
    with pytest.raises(ValueError, match=r"`var_names` must be among \['k'\], got \['c'\]"):
        plots.prior_posterior(updated, ["c"])


def test_long_numbers_below_small_panels_do_not_touch():
    draws = np.random.default_rng(0).normal(size=(1, 2000))
    values = {f"p{i}": (("chain", "draw"), 0.01005 + 3.9e-5 * draws) for i in range(4)}
    wide = {name: (dims, 0.01 + 50.0 * (x - 0.01)) for name, (dims, x) in values.items()}
    tree = xr.DataTree.from_dict({"prior": xr.Dataset(wide), "posterior": xr.Dataset(values)})
    for ax in plots.prior_posterior(tree):
        ax.figure.canvas.draw()
        (first, last), shown = ax.get_xlim(), ax.get_xticklabels()
        boxes = [label.get_window_extent() for label in shown if first <= label.get_position()[0] <= last]
        assert len(boxes) > 1
        assert all(left.x1 < right.x0 for left, right in zip(boxes, boxes[1:], strict=False))


def test_prior_posterior_figure_is_not_stretched_by_one_far_draw():
    rng = np.random.default_rng(1)
    draws = np.append(rng.standard_normal(4999), 40.0)
    one = xr.Dataset({"k": (("chain", "draw"), draws[None])})
    [ax] = plots.prior_posterior(xr.DataTree.from_dict({"prior": one, "posterior": one}))
    left, right = ax.get_xlim()
    assert -5.0 < left < -2.5 and 2.5 < right < 5.0
