"""Figures of draws, in every backend: what is drawn is what the draws say."""

import importlib.util
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from scipy import stats

from pymc_features import plots

PROBABILITIES = [0.05, 0.5, 0.95]
HAS_PLOTLY = all(importlib.util.find_spec(name) for name in ("plotly", "webcolors"))
WITHOUT = pytest.mark.skipif(not HAS_PLOTLY, reason="arviz-plots[plotly] is not installed")
BACKENDS = ["matplotlib", pytest.param("plotly", marks=WITHOUT)]


@pytest.fixture(scope="module")
def idata():
    """A vector and a scalar of two chains that agree, and a prior of the scalar."""
    rng = np.random.default_rng(7)
    chains = {
        "k": (("chain", "draw", "spring"), rng.normal([4.0, 50.0], [1.0, 5.0], (2, 800, 2))),
        "sigma": (("chain", "draw"), rng.lognormal(0.0, 0.3, (2, 800))),
    }
    prior = {"sigma": (("chain", "draw"), rng.lognormal(0.0, 1.0, (1, 2000)))}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(chains), "prior": xr.Dataset(prior)})


def entries(idata):
    """Draws (chain, draw) of each entry, in the order of the panels."""
    posterior = idata["posterior"]
    return [posterior["k"].values[..., 0], posterior["k"].values[..., 1], posterior["sigma"].values]


def traces(drawn, panel):
    """Traces of plotly in one panel."""
    figure = drawn.viz["figure"].item()
    number = "" if panel == 0 else str(panel + 1)
    return [trace for trace in figure.data if (trace.xaxis or "x") == f"x{number}" and None not in trace.x]


def drawn_lines(drawn, panel):
    """Points (2, n) of each line of one panel with more than a few of them."""
    if isinstance(drawn, np.ndarray):
        lines = [line.get_data() for line in drawn[panel].lines]
    else:
        lines = [(trace.x, trace.y) for trace in traces(drawn, panel) if trace.mode == "lines"]
    return [np.array(line, dtype=float) for line in lines if len(line[0]) > 50]


def drawn_areas(drawn, panel):
    """Corners (2, n) of the upper end of each area of one panel."""
    if isinstance(drawn, np.ndarray):
        areas = [area.get_paths()[0].vertices.T for area in drawn[panel].collections]
        return [area[:, area[1] > 0.0] for area in areas]
    tops = [np.array([trace.x, trace.y]) for trace in traces(drawn, panel) if trace.fill == "tonexty"]
    return [top[:, top[1] > 0.0] for top in tops]


def label_of(drawn, panel):
    """What is written below one panel."""
    if isinstance(drawn, np.ndarray):
        return drawn[panel].get_xlabel()
    number = "" if panel == 0 else str(panel + 1)
    return drawn.viz["figure"].item().layout[f"xaxis{number}"].title.text


def quantiles_of(density):
    """Quantiles of a drawn density, values and heights (2, n)."""
    values, heights = density
    share = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(values) * (heights[1:] + heights[:-1]))])
    assert share[-1] == pytest.approx(1.0, abs=0.02)
    return np.interp(PROBABILITIES, share / share[-1], values)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", plots.draws.KINDS)
def test_densities_of_chains_have_the_quantiles_of_their_draws(idata, kind, backend):
    drawn = plots.chains(idata, kind, backend=backend)
    for k, draws in enumerate(entries(idata)):
        densities = drawn_lines(drawn, 2 * k)
        assert len(densities) == 2
        for density, chain in zip(densities, draws, strict=True):
            # the kernel widens a density a little
            expected, spread = np.quantile(chain, PROBABILITIES), chain.std()
            np.testing.assert_allclose(quantiles_of(density), expected, atol=0.15 * spread)
    second = {"rank": "fractional rank", "trace": "draw"}[kind]
    named = [("k[0]", f"k[0]: {second}"), ("k[1]", f"k[1]: {second}"), ("sigma", f"sigma: {second}")]
    assert [label_of(drawn, panel) for panel in range(6)] == [label for pair in named for label in pair]


@pytest.mark.parametrize("backend", BACKENDS)
def test_ranks_of_chains_are_those_of_their_draws(idata, backend):
    """Share of a chain's draws below a rank among all, less what chains that agree have there."""
    drawn = plots.chains(idata, "rank", backend=backend)
    for k, draws in enumerate(entries(idata)):
        ranks = stats.rankdata(draws).reshape(draws.shape) / draws.size
        lines = drawn_lines(drawn, 2 * k + 1)
        assert len(lines) >= 2
        for (at, difference), chain in zip(lines, ranks, strict=False):
            expected = (chain <= at[:, None]).mean(axis=1) - at
            np.testing.assert_allclose(difference, expected, atol=0.01)


@pytest.mark.parametrize("backend", BACKENDS)
def test_traces_are_the_draws(idata, backend):
    drawn = plots.chains(idata, "trace", backend=backend)
    for k, draws in enumerate(entries(idata)):
        lines = {tuple(line[1]) for line in drawn_lines(drawn, 2 * k + 1)}
        assert lines == {tuple(chain) for chain in draws}


@pytest.mark.parametrize("backend", BACKENDS)
def test_prior_and_posterior_are_histograms_of_their_draws(idata, backend):
    drawn = plots.prior_posterior(idata, backend=backend)
    areas = drawn_areas(drawn, 0)
    assert len(areas) == 2
    for group, (values, heights) in zip(("prior", "posterior"), areas, strict=True):
        draws = idata[group]["sigma"].values
        edges = np.unique(values)
        assert heights.max() == 1.0
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            inside = heights[(values > 0.5 * (low + high) - 0.6 * (high - low)) & (values < high + 1e-9)]
            count = np.count_nonzero((draws >= low) & (draws < high))
            assert count == 0 or np.isclose(inside, count / counted(draws, edges)).any()
    drawn_median = median_of(drawn)
    assert drawn_median == pytest.approx(np.median(idata["posterior"]["sigma"]))


def counted(draws, edges):
    """Most draws between two edges."""
    return np.histogram(draws, edges)[0].max()


def median_of(drawn):
    """Where the only vertical line is."""
    if isinstance(drawn, np.ndarray):
        return drawn[0].lines[0].get_xdata()[0]
    return drawn.viz["figure"].item().layout.shapes[0].x0


def test_a_narrow_posterior_leaves_its_prior_to_be_seen(idata):
    """Negative control of heights: as densities the prior would be a thousand times lower."""
    rng = np.random.default_rng(2)
    narrow = xr.Dataset({"sigma": (("chain", "draw"), rng.normal(1.0, 1e-3, (2, 500)))})
    tree = xr.DataTree.from_dict({"posterior": narrow, "prior": idata["prior"].to_dataset()})
    [before, after] = drawn_areas(plots.prior_posterior(tree), 0)
    assert before[1].max() == after[1].max() == 1.0


@pytest.fixture(scope="module")
def updated():
    """A made-up result of an update: gains of two sensors, draws of two natural frequencies."""
    rng = np.random.default_rng(5)
    modal = {"natural_frequency": (("chain", "draw", "mode"), rng.normal([1.0, 3.0], 0.1, (2, 50, 2)))}
    coords = {"sensor": ["floor1", "floor2"], "frequency": np.arange(80.0) / 4.0}
    gain = xr.DataArray(1.0 + rng.random((2, 80)), coords, ("sensor", "frequency"))
    data = {"gain": gain, "peak_frequency": ("peak", [1.1, 2.9]), "given_frequency": ("given", [1.0])}
    parts = {"EXP/modal": xr.Dataset(modal, coords={"mode": [1, 2]}), "data": xr.Dataset(data)}
    return xr.DataTree.from_dict(parts)


@pytest.mark.parametrize("backend", BACKENDS)
def test_natural_frequencies_are_drawn_as_intervals_of_their_draws(updated, backend):
    drawn = plots.natural_frequencies(updated, backend=backend)
    found = updated["EXP/modal"]["natural_frequency"].values.reshape(-1, 2)
    low, middle, high = np.quantile(found, PROBABILITIES, axis=0)
    for line, values in zip(drawn_lines(drawn, 0), updated["data"]["gain"].values, strict=True):
        np.testing.assert_array_equal(line[1], values)
    if backend == "matplotlib":
        intervals = [line.get_xdata() for line in drawn[1].lines[:2]]
        medians = drawn[1].collections[0].get_offsets()[:, 0]
        ticks = [text.get_text() for text in drawn[1].get_yticklabels()]
        marks = {line.get_label(): line.get_xdata()[0] for line in drawn[0].lines[2:]}
        limits = drawn[0].get_xlim()
    else:
        *lines, dots = traces(drawn, 1)
        intervals, medians = [line.x for line in lines], dots.x
        figure = drawn.viz["figure"].item()
        ticks, limits = list(figure.layout.yaxis2.ticktext), figure.layout.xaxis2.range
        marks = {shape.name: shape.x0 for shape in figure.layout.shapes}
    np.testing.assert_allclose(intervals, np.column_stack([low, high]))
    np.testing.assert_allclose(medians, middle)
    assert ticks == ["EXP"]
    assert (marks["peaks of the gain"], marks["given"]) == (1.1, 1.0)
    assert limits == pytest.approx((0.0, 1.3 * high[1]))
    with pytest.raises(ValueError, match="`result` must have a likelihood with natural frequencies"):
        plots.natural_frequencies(xr.DataTree(), backend=backend)


def test_chains_are_drawn_on_axes_of_ones_own(idata):
    axes = plots.chains(idata, "trace", ["sigma"])
    _, own = plt.subplots(2)
    assert plots.chains(idata, "trace", ["sigma"], axes=own)[0] is own[0]
    for ax, other in zip(own, axes, strict=True):
        assert len(ax.lines) == len(other.lines) > 0
        for line, same in zip(ax.lines, other.lines, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), same.get_xydata())
    with pytest.raises(ValueError, match="`axes` must be one for each of 2 columns"):
        plots.chains(idata, "rank", ["sigma"], axes=own[:1])
    with pytest.raises(ValueError, match="`kind` must be one of rank, trace, got 'bars'"):
        plots.chains(idata, "bars")


@pytest.mark.parametrize("draw", [plots.chains, plots.prior_posterior])
def test_backends_that_are_not_there(idata, draw, monkeypatch):
    with pytest.raises(ValueError, match="`backend` must be one of matplotlib, plotly, bokeh, got 'gnuplot'"):
        draw(idata, backend="gnuplot")
    if HAS_PLOTLY:
        with pytest.raises(ValueError, match="`axes` must be left out with backend='plotly'"):
            draw(idata, axes=plt.gca(), backend="plotly")
    monkeypatch.delitem(sys.modules, "arviz_plots.backend.bokeh", raising=False)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    words = "`backend` must be installed, got 'bokeh' without bokeh.*Run pip install 'arviz-plots.bokeh.'"
    with pytest.raises(ImportError, match=words):
        draw(idata, backend="bokeh")
