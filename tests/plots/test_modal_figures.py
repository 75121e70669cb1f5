"""Figures of identified modes: what is drawn is what was measured, and the model's at its best scale."""

import matplotlib.pyplot as plt
import numpy as np
import pymc as pm
import pytest

from pymc_features import ModalDamping, SpringMassChain, modes, plots
from pymc_features.modal import ModalData, mac

CHANNELS = [0, 2]


def chain_modes(k):
    found = SpringMassChain([1.0, 1.0, 1.0], 100.0 * np.asarray(k), ModalDamping(0.01)).modes()
    return found.natural_frequencies, found.mode_shapes.T


@pytest.fixture(scope="module")
def draws():
    """Frequencies (chain, draw, mode) and shapes (chain, draw, mode, storey) of a made-up posterior."""
    rng = np.random.default_rng(3)
    found = [chain_modes(rng.lognormal(0.0, 0.15, 3)) for _ in range(40)]
    return tuple(np.array([pair[k] for pair in found]).reshape(2, 20, *found[0][k].shape) for k in (0, 1))


@pytest.fixture(scope="module")
def measured():
    frequencies, shapes = chain_modes([1.0, 1.1, 0.9])
    return ModalData(frequencies[:2], -7.0 * shapes[:2, CHANNELS], ["low", "roof"])


def test_mac_matrix(measured, draws):
    frequencies, shapes = draws
    at = shapes[..., CHANNELS]
    [ax] = plots.mac(measured, at, frequencies, partners=[0, 1])
    flat = at.reshape(40, 3, 2)
    products = np.array(
        [[[abs(a @ b) ** 2 / (a @ a) / (b @ b) for b in d] for a in measured.shapes] for d in flat]
    )
    low, middle, high = np.quantile(products, [0.05, 0.5, 0.95], axis=0)
    np.testing.assert_allclose(ax.images[0].get_array(), middle, rtol=1e-12)
    cells = [text.get_text() for text in ax.texts]
    assert cells[1] == f"{middle[0, 1]:.2f}\n{low[0, 1]:.2f}-{high[0, 1]:.2f}"
    assert [patch.get_xy() for patch in ax.patches] == [(-0.5, -0.5), (0.5, 0.5)]
    medians = np.median(frequencies, axis=(0, 1))
    assert [t.get_text() for t in ax.get_xticklabels()] == [f"f{k + 1}: {medians[k]:.4g}" for k in range(3)]
    assert ax.get_yticklabels()[1].get_text() == f"{measured.frequencies[1]:.4g}"


def test_modes_go_into_figures_as_they_are(measured):
    """Modes of a structure, those inside a model where they are numbers, and identified ones."""
    chain = SpringMassChain([1.0, 1.0, 1.0], [110.0, 100.0, 90.0], ModalDamping(0.01))
    found = chain.modes()
    rows = found.mode_shapes.T[:, CHANNELS]
    others = ModalData(found.natural_frequencies, rows, measured.channels)
    for given in (modes(chain, sensors=CHANNELS), others):
        [ax] = plots.mac(measured, given)
        np.testing.assert_allclose(ax.images[0].get_array(), mac(measured.shapes, rows), rtol=1e-12)
        assert ax.get_xticklabels()[0].get_text() == f"f1: {found.natural_frequencies[0]:.4g}"
    axes = plots.mode_shapes(measured, found, sensors=CHANNELS)
    assert f"model f1: {found.natural_frequencies[0]:.4g} Hz" in axes[0].get_title()
    with pm.Model():
        factor = pm.LogNormal("factor")
        random = modes(SpringMassChain(np.ones(3), 100.0 * factor, ModalDamping(0.01)), sensors=CHANNELS)
        with pytest.raises(TypeError, match="`shapes` must be modes of numbers, got those of random"):
            plots.mac(measured, random)


def test_mac_matrix_of_one_structure_and_of_missing_entries(measured):
    _, shapes = chain_modes([1.0, 1.1, 0.9])
    whole = ModalData([1.0, 2.0], [[1.0, 2.0, np.nan], [np.nan] * 2 + [1.0]], ["a", "b", "c"])
    [ax] = plots.mac(whole, shapes)
    expected = mac(whole.shapes, shapes)
    assert [t.get_text() for t in ax.texts[:3]] == [f"{v:.2f}" for v in expected[0]]
    assert ax.get_xlabel() == "mode of the model"
    nothing = ModalData([1.0, 2.0], [[1.0, np.nan], [np.nan, 1.0]], ["a", "b"])
    [ax] = plots.mac(nothing, [[0.0, 1.0], [1.0, 0.0]], axes=ax)
    assert [t.get_text() for t in ax.texts[-4:]] == ["-", "1.00", "1.00", "-"]


def test_shapes_along_the_storeys(measured, draws):
    frequencies, shapes = draws
    axes = plots.mode_shapes(measured, shapes, frequencies, sensors=CHANNELS)
    flat = shapes.reshape(40, 3, 3)
    for k, ax in enumerate(axes):
        lines = {line.get_label(): line.get_xydata() for line in ax.lines}
        own = measured.shapes[k] / np.abs(measured.shapes[k]).max()
        own = own * np.sign(own[np.abs(own).argmax()])
        np.testing.assert_allclose(lines["measured"], np.column_stack([own, [1, 3]]))
        # the factor by a solver of least squares
        factors = [np.linalg.lstsq(d[k, CHANNELS][:, None], own, rcond=None)[0][0] for d in flat]
        expected = np.quantile(np.array(factors)[:, None] * flat[:, k], [0.05, 0.5, 0.95], axis=0)
        np.testing.assert_allclose(lines["model, median"], np.c_[[0.0, *expected[1]], range(4)], atol=1e-12)
        corners = {tuple(np.round(v, 9)) for v in ax.collections[0].get_paths()[0].vertices}
        assert {(round(expected[0, 1], 9), 2.0), (round(expected[2, 1], 9), 2.0)} <= corners
    assert axes[1].get_title().startswith(f"measured {measured.frequencies[1]:.4g} Hz\nmodel f2: ")
    assert axes[1].get_ylim()[0] == 0.0


def test_partners_are_those_of_the_largest_mac(measured, draws):
    _, shapes = draws
    reversed_modes = shapes[..., ::-1, :]
    axes = plots.mode_shapes(measured, reversed_modes, sensors=CHANNELS)
    assert [ax.get_title().split("\n")[1] for ax in axes] == [f"model f{k}" for k in (3, 2)]
    axes = plots.mode_shapes(measured, shapes, sensors=CHANNELS, partners=[2, 2], axes=axes)
    assert [ax.get_title().split("\n")[1] for ax in axes] == ["model f3"] * 2


def test_shapes_in_space():
    """Two floors that move along x and y above a base, and a second row of the same places."""
    mast = {"coordinates": [[0, 0, 0], [0, 0, 4], [0, 0, 10], [0, 0, 4], [0, 0, 10]], "lines": [[0, 1, 2]]}
    mast["directions"] = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    modes = ModalData([1.0], [[0.5, 1.0]], ["first", "top"])
    shapes = [[0.7, 0.5, 1.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.6, 1.0]]
    [ax] = plots.mode_shapes(modes, shapes, sensors=[1, 2], nodes=mast)
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    step, oblique = 0.15 * 10.0, 0.45 * np.array([np.cos(0.6), np.sin(0.6)])
    moved = step * np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    moved[2] += step * 0.2 * oblique
    still = [[0.0, 0.0], [0.0, 4.0], [0.0, 10.0]]
    np.testing.assert_allclose(lines["model"], still + moved)
    np.testing.assert_allclose(lines["measured"], [[0.5 * step, 4.0], [step, 10.0]])
    assert ax.get_aspect() == 1.0


def test_plane_of_a_bridge(draws):
    modes = ModalData([1.0], [[0.5, 1.0, 0.4]], ["a", "b", "c"])
    deck = {"coordinates": [[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]]}
    [ax] = plots.mode_shapes(modes, draws[1], nodes=deck)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "z [m]")
    measured = {line.get_label(): line.get_xydata() for line in ax.lines}["measured"]
    np.testing.assert_allclose(measured, [[0.0, 0.75], [5.0, 1.5], [10.0, 0.6]])
    assert len(ax.collections[1].get_segments()) == 40  # of all draws


def test_figures_of_modes_refuse_what_does_not_fit(measured, draws):
    _, shapes = draws
    mac_of, shapes_of, at = plots.mac, plots.mode_shapes, {"sensors": CHANNELS}
    three = np.zeros((3, 3))
    for figure, given, settings, words in (
        (mac_of, (ModalData([1.0]), np.eye(2)), {}, "`measured` must be a ModalData with shapes, got freq"),
        (mac_of, (measured, shapes), {}, r"`shapes` must be \(..., mode, channel\) with the 2 channels"),
        (mac_of, (measured, np.full((2, 2), np.nan)), {}, "`shapes` must be finite in some draw"),
        (mac_of, (measured, shapes[..., CHANNELS]), {"partners": [0]}, "`partners` must be 2 whole numbers"),
        (
            mac_of,
            (measured, shapes[..., CHANNELS], [1.0, 2.0]),
            {},
            r"`frequencies` must be \(2, 20, 3\) pos",
        ),
        (shapes_of, (measured, shapes), {}, "`sensors` must be given for 2 channels and 3 columns"),
        (shapes_of, (measured, shapes), {"sensors": [0, 3]}, "`sensors` must be 2 whole numbers from 0 to 2"),
        (shapes_of, (measured, shapes), at | {"axes": plt.gca()}, "`axes` must be one for each of 2 ident"),
    ):
        with pytest.raises(ValueError, match=words):
            figure(*given, **settings)
    for nodes, words in (
        ({"coordinates": [[0.0, 0.0]]}, "with 3 rows of 2 or 3 finite coordinates"),
        ({"coordinates": three, "lines": [[0, 3]]}, "with lines that are lists of rows from 0 to 2"),
        ({"coordinates": three, "joints": 1}, "a mapping of coordinates, directions, lines"),
        ({"lines": [[0, 1]]}, "a mapping of coordinates, directions, lines"),
    ):
        with pytest.raises(ValueError, match=f"`nodes` must be {words}"):
            plots.mode_shapes(measured, shapes, sensors=CHANNELS, nodes=nodes)
