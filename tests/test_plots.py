"""Figures show what the result holds."""

import numpy as np
import pytest
import xarray as xr

from pymc_features import plots


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
    ax = plots.plot_record(result)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [0.0, -2.0, 1.0])
    assert ax.lines[1].get_xydata().tolist() == [[0.1, -2.0]]
    assert (ax.get_xlabel(), ax.get_title()) == ("time [s]", "pulse")
    assert plots.plot_record(result, ax=ax) is ax
    plots.close([ax])


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
    axes = plots.plot_loops(loops)
    assert [ax.get_title() for ax in axes] == [
        f"spring {i}: ductility {d}" for i, d in ((2, 4), (3, 3), (0, 2))
    ]
    np.testing.assert_allclose(axes[0].lines[0].get_xydata(), [[0, 0], [4, 40], [-4, -40]])
    assert [line.get_xdata()[0] for line in axes[0].lines[1:]] == [-1.0, 1.0]
    assert axes[0].figure.get_suptitle() == "Bouc-Wen chain, pulse"
    [ax] = plots.plot_loops(loops, springs=1, axes=axes[2])
    assert ax.get_title() == "spring 1: ductility 0.5"
    plots.close(axes[:1])
    with pytest.raises(ValueError, match=r"`springs` must be among \[0, 1, 2, 3\], got \[7\]"):
        plots.plot_loops(loops, springs=7)
    with pytest.raises(ValueError, match="`axes` must be one for each of 2 springs, got 1"):
        plots.plot_loops(loops, springs=[0, 1], axes=ax)
    with pytest.raises(ValueError, match="`result` must be of a structure whose springs can yield"):
        plots.plot_loops(xr.DataTree())


def test_titles_name_the_structure(loops):
    axes = plots.plot_sampling_rate(loops, ["EXP", "ABC"])
    assert axes[0].figure.get_suptitle() == "EXP and ABC, Bouc-Wen chain"
    ax = plots.plot_widths(loops)
    assert ax.get_title() == "Bouc-Wen chain"
    plots.close([axes[0], ax])


def test_tolerance_figure():
    result = xr.Dataset(
        {
            "theta": (("epsilon", "quantile"), [[0.5, 1.0, 1.5], [0.9, 1.0, 1.1]]),
            "log_probability": ("epsilon", [-1.0, -3.0]),
        },
        coords={"epsilon": [1.0, 0.1], "quantile": [0.05, 0.5, 0.95]},
    )
    [ax] = plots.plot_tolerance(result)
    assert ax.lines[0].get_xydata().tolist() == [[1.0, 1.0], [0.1, 1.0]]
    band = ax.collections[0].get_paths()[0].vertices
    assert {(1.0, 0.5), (1.0, 1.5), (0.1, 0.9), (0.1, 1.1)} <= set(map(tuple, band))
    assert (ax.get_ylabel(), ax.get_xscale()) == ("theta", "log")
    assert plots.plot_tolerance(result, ax=[ax])[0] is ax
    plots.close([ax])
    with pytest.raises(ValueError, match="`result` must have a scalar parameter, got none"):
        plots.plot_tolerance(result[["log_probability"]])


def test_widths_figure(result):
    ax = plots.plot_widths(result)
    exact, sampled = ax.lines[0].get_xydata(), ax.lines[1].get_xydata()
    np.testing.assert_allclose(exact, [[0.1, 0.5], [1.0, 0.5], [10.0, 0.5]])
    np.testing.assert_allclose(sampled, exact)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["EXP", "ABC"]
    assert plots.plot_widths(result, ax=ax) is ax
    plots.close([ax])


def test_sampling_rate_figure(result):
    axes = plots.plot_sampling_rate(result, ["EXP", "ABC"])
    assert axes.shape == (2,)
    theta, sigma = axes
    assert len(theta.containers) == 2
    assert len(sigma.containers) == 1  # ABC has no sigma
    bars = theta.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose([s[:, 1] for s in bars], [[0.8, 1.3]] * 3)
    assert [t.get_text() for t in theta.get_xticklabels()] == ["0.1", "1", "10"]
    assert "σ [m/s²]" in sigma.get_ylabel()
    plots.close(axes[:1])
    with pytest.raises(ValueError, match=r"`likelihoods` must be among \['EXP', 'ABC'\], got \['TN'\]"):
        plots.plot_sampling_rate(result, "TN")
