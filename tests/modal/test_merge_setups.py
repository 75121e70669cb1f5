"""Set-ups of one structure, each with scales of its own, merged: the shapes they came from."""

import numpy as np
import pytest

from pymc_features.exceptions import ModalDataWarning
from pymc_features.modal import ModalData, merge_setups
from support.refusals import refusals

N = 9
NAMES = [f"floor {k}" for k in range(1, N + 1)]
FREQUENCIES = np.array([1.0, 2.9, 4.7, 6.3])
# a uniform chain: phi_k = sin((2 j - 1) pi k / (2 n + 1))
SHAPES = np.sin((2 * np.arange(1, 5)[:, None] - 1) * np.pi * np.arange(1, N + 1) / (2 * N + 1))
PARTS = [[0, 8, 1, 2], [3, 4, 0, 8], [8, 5, 6, 7, 0]]  # references: floors 1 and 9


def setup(part, seed=0, noise=0.0, is_complex=False, modes=(0, 1, 2, 3), **more):
    """Some channels of all modes, each in a scale and sense of its own."""
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0.2, 5.0, 4) * rng.choice([-1.0, 1.0], 4)
    if is_complex:
        factors = factors * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, 4))
    entries = factors[:, None] * (SHAPES + noise * rng.standard_normal((4, N)))
    modes = list(modes)
    return ModalData(FREQUENCIES[modes], entries[modes][:, part], [NAMES[k] for k in part], **more)


def up_to_scale(found, expected):
    """Shapes (m, s) by the factor of least squares that brings each to the expected one."""
    return np.array([a * (np.vdot(a, b) / np.vdot(a, a)) for a, b in zip(found, expected, strict=True)])


@pytest.mark.parametrize("is_complex", [False, True])
def test_merged_shapes_are_those_they_came_from(is_complex):
    setups = [setup(part, seed, is_complex=is_complex) for seed, part in enumerate(PARTS)]
    merged = merge_setups(setups, ["floor 1", "floor 9"])
    assert merged.channels == tuple(NAMES[k] for k in (0, 8, 1, 2, 3, 4, 5, 6, 7))
    assert merged.is_complex == is_complex
    found = merged.select(channels=NAMES).shapes
    np.testing.assert_allclose(up_to_scale(found, SHAPES), SHAPES, atol=1e-12)
    first = merged.select(channels=setups[0].channels).shapes
    np.testing.assert_allclose(first, setups[0].shapes, rtol=1e-12)  # in the scale of the first
    np.testing.assert_allclose(merge_setups(setups).select(channels=NAMES).shapes, found)


def test_set_ups_that_overlap_one_after_the_other():
    """No channel is in all of them, and the last two are given in the wrong order."""
    chain = [[0, 1, 2], [8, 7, 6, 5], [2, 3, 4, 5]]
    merged = merge_setups([setup(part, seed) for seed, part in enumerate(chain)], least_mac=0.99)
    np.testing.assert_allclose(up_to_scale(merged.select(channels=NAMES).shapes, SHAPES), SHAPES, atol=1e-12)
    with pytest.raises(ValueError, match="must be connected by references, set-ups .2, 3. share none with"):
        merge_setups([setup(part) for part in ([0, 1], [1, 2], [5, 6], [6, 7])])


def test_the_factor_is_that_of_least_squares():
    """With noise: the second set-up by numpy's lstsq at the references, references averaged."""
    first, second = setup(PARTS[0], 5, 0.05), setup(PARTS[1], 6, 0.05)
    merged = merge_setups([first, second])
    for k in range(4):
        a, b = first.shapes[k, [0, 1]], second.shapes[k, [2, 3]]
        factor = np.linalg.lstsq(b[:, None], a)[0][0]
        expected = [*(0.5 * (a + factor * b)), *first.shapes[k, 2:], *(factor * second.shapes[k, :2])]
        np.testing.assert_allclose(merged.shapes[k], expected, rtol=1e-12)


def test_order_of_modes_does_not_matter():
    """Modes of equal frequency but for a percent are told apart by their shapes."""
    close = np.array([1.0, 1.01, 4.7, 6.3])
    first, second = setup(PARTS[0], 1), setup(PARTS[1], 2)
    first = ModalData(close, first.shapes, first.channels)
    swapped = [1, 0, 3, 2]  # and their frequencies are those of each other
    second = ModalData(close[[0, 1, 3, 2]], second.shapes[swapped], second.channels)
    found = merge_setups([first, second], frequency_tolerance=0.03).select(
        channels=[NAMES[k] for k in range(5)]
    )
    np.testing.assert_allclose(up_to_scale(found.shapes, SHAPES[:, :5]), SHAPES[:, :5], atol=1e-12)


def test_one_reference_leaves_it_to_the_frequencies():
    """Where every pair is allowed, those with the least differences in total."""
    first = ModalData([1.0, 1.02], [[1.0, 0.1], [1.0, 0.2]], ["a", "b"])
    second = ModalData([1.021, 0.999], [[1.0, 0.4], [1.0, 0.3]], ["a", "c"])
    merged = merge_setups([first, second])
    np.testing.assert_allclose(merged.frequencies, [0.9995, 1.0205])
    np.testing.assert_allclose(merged.shapes, [[1.0, 0.1, 0.3], [1.0, 0.2, 0.4]])


def two(x, y, sds=(None, None), **more):
    channels = ["a", "b"]
    return [
        ModalData([f], [[1.0, 2.0]], channels, frequency_sd=sd, **{k: v[i] for k, v in more.items()})
        for i, (f, sd) in enumerate(zip((x, y), sds, strict=True))
    ]


def test_means_of_frequencies():
    plain = merge_setups(two(2.0, 2.04))
    assert (plain.frequencies, plain.frequency_sd) == (pytest.approx([2.02]), None)
    half = merge_setups(two(2.0, 2.04, ([0.01], None)))
    assert (half.frequencies, half.frequency_sd) == (pytest.approx([2.02]), None)
    close = merge_setups(two(2.0, 2.01, ([0.01], [0.02])))  # weights 4 and 1
    assert close.frequencies == pytest.approx([(4 * 2.0 + 2.01) / 5])
    assert close.frequency_sd == pytest.approx([1.0 / np.sqrt(0.01**-2 + 0.02**-2)])


def test_set_ups_that_scatter_more_than_they_say():
    """Birge's ratio: chi^2 per degree of freedom is 4^2 / 2 for two results four deviations apart."""
    apart = merge_setups(two(2.0, 2.04, ([0.01], [0.01])))
    assert apart.frequency_sd == pytest.approx([0.01 / np.sqrt(2) * np.sqrt(8.0)])


def test_damping_and_standard_deviations_of_entries():
    merged = merge_setups(
        two(2.0, 2.0, damping_ratios=([0.01], [0.03]), shape_sd=([[0.3, 0.0]], [[0.4, 0.2]]))
    )
    assert merged.damping_ratios == pytest.approx([0.02])
    assert merged.damping_sd is None
    np.testing.assert_allclose(merged.shape_sd, [[0.25, 0.1]])  # of a mean of two
    one = merge_setups(two(2.0, 2.0, damping_ratios=([0.01], None), damping_sd=([0.002], None)))
    assert (one.damping_ratios, one.damping_sd) == (pytest.approx([0.01]), pytest.approx([0.002]))
    moving = ModalData([2.0], [[-2.0, 1.0]], ["a", "c"], shape_sd=[[0.0, 0.3]])
    scaled = merge_setups([ModalData([2.0], [[1.0]], ["a"], shape_sd=[[0.0]]), moving])
    np.testing.assert_allclose(scaled.shapes, [[1.0, -0.5]])
    np.testing.assert_allclose(scaled.shape_sd, [[0.0, 0.15]])


def test_a_mode_that_some_set_ups_did_not_find():
    setups = [setup(PARTS[0], 1, modes=(0, 1, 3)), setup(PARTS[1], 2), setup(PARTS[2], 3)]
    with pytest.warns(ModalDataWarning, match="The mode at 4.7 Hz is in set-ups .1, 2") as caught:
        merged = merge_setups(setups)
    assert len(caught) == 1
    assert merged.frequencies.tolist() == FREQUENCIES.tolist()
    third = merged.shapes[2]
    missing = [name in ("floor 2", "floor 3") for name in merged.channels]
    np.testing.assert_array_equal(np.isnan(third), missing)
    known = [NAMES.index(name) for name in np.array(merged.channels)[~np.isnan(third)]]
    np.testing.assert_allclose(
        up_to_scale(third[None, ~np.isnan(third)], SHAPES[2:3, known])[0], SHAPES[2, known]
    )


def test_references_that_hardly_move():
    setups = [ModalData([1.0], [[0.01, 1.0]], ["a", "b"]), ModalData([1.0], [[0.5, 1.0]], ["a", "c"])]
    with pytest.warns(ModalDataWarning, match="references hardly move in the mode at 1 Hz of set-up 0, 0.01"):
        merge_setups(setups)


GOOD = setup(PARTS[0], 1)
HERTZ = setup(PARTS[1], 2)
RADIANS = ModalData(2.0 * np.pi * FREQUENCIES, HERTZ.shapes, HERTZ.channels)
MIRRORED = ModalData(FREQUENCIES[1:2], HERTZ.shapes[1:2] * [1, 1, 1, -1], HERTZ.channels)
VALUES = {
    "set-up 1 has none.*": ([GOOD, ModalData([1.0])], {}),
    "`setups` must have channels in common, got none": ([GOOD, ModalData([1.0], [[1.0]], ["roof"])], {}),
    "must name all channels that set-ups share, 'floor 9' is": ([GOOD, HERTZ], {"references": ["floor 1"]}),
    "`channels` must be among those of several set-ups .floor": ([GOOD, HERTZ], {"references": ["floor 2"]}),
    "`references` must move in every mode, the mode at 1 Hz": (
        [GOOD, ModalData([1.0], [[0.0, 1.0]], ["floor 1", "x"])],
        {"references": ["floor 1"]},
    ),
    "set-up 1 .6.283, .* has none of the others .1, .*They differ by 2 pi: are those": ([GOOD, RADIANS], {}),
    "They differ by 2 pi: are those of the others in rad/s": ([RADIANS, GOOD], {}),
    "Frequencies agree, shapes do not: the best modal assurance": ([GOOD.select(modes=[1]), MIRRORED], {}),
    "within 5 % .*Raise": ([GOOD, ModalData([10.0], GOOD.shapes[:1], GOOD.channels)], {}),
    "`frequency_tolerance` must be a fraction from 0 to 1": ([GOOD, HERTZ], {"frequency_tolerance": 5.0}),
    "`least_mac` must be from 0 to 1, got 1.5": ([GOOD, HERTZ], {"least_mac": 1.5}),
}
TYPES = {
    "`setups` must be a sequence of at least two ModalData, got .ModalData": ([GOOD], {}),
    "`setups` must be ModalData, got str at index 1. Read it with `read_modal`": ([GOOD, "modes.csv"], {}),
}


@refusals("setups options", VALUES, TYPES)
def test_refusals(setups, options, error, match):
    with pytest.raises(error, match=match):
        merge_setups(setups, **options)


def test_a_looser_criterion_takes_what_was_refused():
    """The counterpart: the shapes that do not agree are merged if they are let."""
    with pytest.warns(ModalDataWarning):  # the other modes are in one set-up
        merged = merge_setups([GOOD, MIRRORED], least_mac=0.0)
    assert len(merged) == 4
