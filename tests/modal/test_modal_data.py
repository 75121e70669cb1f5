"""Identified modes: what is refused, what is selected, and complex shapes on the real axis."""

import copy
import pickle

import numpy as np
import pytest

from pymc_features.modal import ModalData, mac
from support.refusals import refusals

F = [1.2, 3.5, 5.0]
SHAPES = [[0.3, 1.0], [1.0, -0.4], [0.9, 0.1]]
NAMES = ["floor 1", "roof"]
NAN = float("nan")


def whole():
    return ModalData(
        F,
        SHAPES,
        NAMES,
        frequency_sd=[0.01, 0.02, 0.03],
        damping_ratios=[0.01, NAN, 0.02],
        damping_sd=[0.001, NAN, 0.0],
        shape_sd=[[0.01, 0.0], [0.0, 0.02], [NAN, 0.01]],
        name="tower",
    )


def test_what_it_holds():
    modal = whole()
    assert (len(modal), modal.channels, modal.is_complex) == (3, ("floor 1", "roof"), False)
    np.testing.assert_array_equal(modal.shapes, SHAPES)
    assert repr(modal) == "ModalData('tower', 3 modes from 1.2 to 5 Hz, 2 channels)"
    assert repr(ModalData([2.0])) == "ModalData(1 mode of 2 Hz)"
    assert ModalData(F, np.array(SHAPES) * 1j, NAMES).is_complex


@pytest.mark.parametrize("again", [copy.deepcopy, lambda modal: pickle.loads(pickle.dumps(modal)), copy.copy])
def test_it_is_immutable(again):
    modal = again(whole())
    for name in ("frequencies", "shapes", "frequency_sd", "damping_ratios", "damping_sd", "shape_sd"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(modal, name)[0] = 1.0
        np.testing.assert_array_equal(getattr(modal, name), getattr(whole(), name))
    with pytest.raises(AttributeError):
        modal.name = "another"
    assert modal.channels == whole().channels
    given = np.array(F)
    modal, given[0] = ModalData(given), 9.0
    assert modal.frequencies[0] == 1.2, "it is a copy"


VALUES = {
    "`frequencies` must have shape .m,. with at least one mode, got .0,": ([],),
    "`frequencies` must be finite, got nan at index 1. Leave the mode out": ([1.0, NAN],),
    "`frequencies` must be positive, got 0.0 Hz of mode 0. Leave out modes of a rigid": ([0.0, 1.0],),
    "`channels` must have different names, got roof more than once": (F, SHAPES, ["roof", " roof"]),
    "`channels` must have a name each, got none at index 1": (F, SHAPES, ["roof", " "]),
    "`channels` must be left out without `shapes`, got 1 names": (F, None, ["roof"]),
    r"must have shape \(mode, channel\) = \(3, 2\), got \(2, 3\). Tr": (F, np.transpose(SHAPES), NAMES),
    r"must have shape \(mode, channel\) = \(3, 1\), got \(3, 2\). Pass a name": (F, SHAPES, ["roof"]),
    "`shapes` must be finite, or NaN where nothing was measured": (F, [[1.0, np.inf], *SHAPES[1:]], NAMES),
    "an entry that is not zero in each mode, got none in": (F, [SHAPES[0], [0.0, NAN], SHAPES[2]], NAMES),
    "an entry that is not zero in each mode, got none in mode 0": (
        F,
        [[complex(NAN, 1), 0], *SHAPES[1:]],
        NAMES,
    ),
    r"`frequency_sd` must have shape \(mode,\) = \(3,\), got \(1,\)": (F, None, (), [0.1]),
    "`frequency_sd` must be positive, got 0.0 Hz. Leave it out": (F, None, (), [0.1, 0.0, 0.1]),
    "`frequency_sd` must be finite, got nan at index 2. Leave it out": (F, None, (), [0.1, 0.1, NAN]),
    "must be fractions from 0 to 1, got 1.2. Divide a percentage by": (F, None, (), None, [1.2, 0.5, 0.8]),
    "`damping_sd` must be at least 0, or NaN where it is not": (F, None, (), None, None, [0.1, -1.0, 0.1]),
    r"`shape_sd` must have shape \(mode, channel\) = \(3, 2\), got \(3,\). Pass one for each channel": (
        F,
        SHAPES,
        NAMES,
        None,
        None,
        None,
        [0.1, 0.1, 0.1],
    ),
    r"`shape_sd` must have shape \(mode, channel\) = \(3, 0\), got \(3, 2\)": (
        F,
        None,
        (),
        None,
        None,
        None,
        SHAPES,
    ),
}
TYPES = {
    "`frequencies` must be an array of numbers, got str. Pass Hz, or read files": ("modes.csv",),
    "`channels` must be a sequence of names, got 'roof'": (F, SHAPES, "roof"),
    "`shapes` must be an array of numbers, got list": (F, [["a", "b"]], NAMES),
}


@refusals("arguments", VALUES, TYPES)
def test_refusals(arguments, error, match):
    with pytest.raises(error, match=match):
        ModalData(*arguments)


def test_select():
    part = whole().select(modes=[2, 0], channels=["roof"])
    np.testing.assert_array_equal(part.frequencies, [5.0, 1.2])
    np.testing.assert_array_equal(part.shapes, [[0.1], [1.0]])
    np.testing.assert_array_equal(part.shape_sd, [[0.01], [0.0]])
    np.testing.assert_array_equal(part.damping_ratios, [0.02, 0.01])
    assert (part.channels, part.name) == (("roof",), "tower")
    assert whole().select().channels == whole().channels
    assert ModalData(F).select(modes=[1]).frequencies == [3.5]


SELECTIONS = {
    "`channels` must be among those of these modes .floor 1, roof., got 'attic'": {
        "channels": ["roof", "attic"]
    },
    "`modes` must be an integer from 0 to 2, got 3": {"modes": [0, 3]},
}


@refusals(
    "options",
    SELECTIONS,
    {"`channels` must be a sequence of at least one name, got 'roof'": {"channels": "roof"}},
)
def test_selections_that_are_refused(options, error, match):
    with pytest.raises(error, match=match):
        whole().select(**options)


def test_shapes_that_are_not_there():
    for use in (lambda m: m.select(channels=["roof"]), lambda m: m.phase_collinearity):
        with pytest.raises(ValueError, match="`shapes` must be there for this, got frequencies alone"):
            use(ModalData(F))


def random_complex(seed, spread):
    """A real shape (8,), and a copy whose phases spread, turned by an angle."""
    rng = np.random.default_rng(seed)
    shape = rng.standard_normal(8)
    return shape, shape * np.exp(1j * (spread * rng.standard_normal(8) + rng.uniform(-np.pi, np.pi)))


@pytest.mark.parametrize("spread", [0.05, 2.0])
def test_phase_collinearity_is_that_of_the_principal_axes(spread):
    """((s_1^2 - s_2^2) / (s_1^2 + s_2^2))^2, with the singular values of the two columns Re and Im."""
    _, shape = random_complex(0, spread)
    s = np.linalg.svd(np.column_stack([shape.real, shape.imag]), compute_uv=False) ** 2
    modal = ModalData([1.0], [shape], [str(k) for k in range(8)])
    assert modal.phase_collinearity == pytest.approx([((s[0] - s[1]) / (s[0] + s[1])) ** 2], abs=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_real_shape_leaves_the_least_imaginary_part(seed):
    """Beside all angles of half a turn, a hundred thousand of them."""
    _, shape = random_complex(seed, 0.3)
    shape[3] = np.nan
    measured = shape[~np.isnan(shape)]
    angles = np.linspace(0.0, np.pi, 100_001)
    left = (np.exp(1j * angles[:, None]) * measured).imag
    best = (np.exp(1j * angles[(left**2).sum(axis=1).argmin()]) * measured).real
    best *= np.sign(best[np.abs(best).argmax()])
    turned = ModalData([1.0], [shape], [str(k) for k in range(8)]).real()
    assert np.isnan(turned.shapes[0, 3]) and not turned.is_complex
    np.testing.assert_allclose(np.delete(turned.shapes[0], 3), best, atol=1e-4)


def test_a_real_shape_in_any_phase_comes_back():
    shape, turned = random_complex(1, 0.0)
    modal = ModalData([1.0], [turned], [str(k) for k in range(8)])
    assert modal.phase_collinearity == pytest.approx([1.0], abs=1e-12)
    np.testing.assert_allclose(
        modal.real().shapes[0], shape * np.sign(shape[np.abs(shape).argmax()]), atol=1e-12
    )
    same = whole()
    assert same.real() is same


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_mac(scale):
    rng = np.random.default_rng(3)
    a, b = (rng.standard_normal(6) + 1j * rng.standard_normal(6) for _ in range(2))
    expected = abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a) * np.vdot(b, b)).real
    np.testing.assert_allclose(mac([scale * a], [b]), [[expected]], rtol=1e-12)
    gaps = np.where(np.arange(6) < 2, np.nan, b)
    np.testing.assert_allclose(mac([a], [gaps]), mac([a[2:]], [b[2:]]), rtol=1e-12)
    assert np.isnan(mac(np.zeros((1, 3)), np.ones((1, 3)))) and np.isnan(mac([[1.0, NAN]], [[NAN, 1.0]]))
    with pytest.raises(ValueError, match="rows of equal length"):
        mac([a], [b[:2]])
