"""Histories, gradients and populations of structures with massless parts, against the condensed structure."""

import json

import numpy as np
import pytest
from scipy import sparse
from scipy.io import loadmat

from pymc_features import LinearStructure, ModalDamping, simulate
from pymc_features.simulators import QUANTITIES
from support.kernels import (
    linear_discrepancy_gradient,
    linear_population_discrepancy,
    linear_population_gradient,
    linear_response,
    linear_response_gradient,
    linear_response_tangent,
)
from support.massless import KINDS, RAYLEIGH, Cantilever
from support.reference import richardson
from support.straight import Loading
from support.structures import noise_record, peak_error

RECORD = noise_record(120, 0.05, seed=4)
THETA = np.array([1.0, 0.8, 0.3])
RATIOS = ModalDamping(np.linspace(0.01, 0.06, 4))
DAMPINGS = {"rayleigh": RAYLEIGH, "ratios": RATIOS, "matrix": None}

kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
arms = pytest.mark.parametrize("arm", [0.0, 0.4])
dampings = pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)


def by_condensation(beam, theta, damping, quantity, n_modes=None):
    """Response of all degrees of freedom by that of the masses."""
    structure, static = beam.condensed_structure(theta, damping)
    relative = simulate(
        structure, RECORD, quantity=QUANTITIES[max(quantity, 1)], outputs=static, n_modes=n_modes
    )
    return relative.values + (quantity == 0) * beam.influence[:, None] * RECORD.acceleration


def arguments_of(structure, outputs, quantity, record=RECORD, n_modes=None):
    """What the kernels take."""
    return (
        *(*structure.parameters(), *structure.constants(record), structure.excitation(record)),
        *(record.dt, 1, 1, outputs, n_modes or structure.n_modes, quantity),
    )


@kinds
@arms
@dampings
def test_histories_are_those_of_the_condensed_structure(kind, arm, damping):
    """All quantities to 1e-10 of the peak, with mass and without; the reference of all modes needs none."""
    beam = Cantilever(arm=arm)
    structure = beam.structure(THETA, damping, kind)
    assert structure.n_modes == 4 and structure.n_dof == 8
    for code, quantity in enumerate(QUANTITIES):
        if damping is RATIOS:
            expected = by_condensation(beam, THETA, damping, code)
        else:
            rayleigh = None if damping is None else (RAYLEIGH.alpha, RAYLEIGH.beta)
            expected = beam.response(THETA, RECORD, code, rayleigh)
        assert peak_error(simulate(structure, RECORD, quantity=quantity), expected) < 1e-10
        kernel = linear_response(*arguments_of(structure, np.eye(8), code))
        assert peak_error(kernel, expected) < 1e-10
        if damping is RAYLEIGH:  # few of twelve modes, sparse ones by Lanczos iteration
            long = Cantilever(12, arm)
            expected = by_condensation(long, THETA, damping, code, 3)
            found = simulate(long.structure(THETA, kind=kind), RECORD, quantity=quantity, n_modes=3)
            assert peak_error(found, expected) < 1e-10


def derivatives(beam, damping, quantity, n_modes):
    """By theta, and by Rayleigh's pair where it is given, (k, n, time)."""
    if damping is RATIOS or n_modes:

        def history(theta):
            return by_condensation(beam, theta, damping, quantity, n_modes)

        return np.array([richardson(history, THETA, unit, 2e-3) for unit in np.eye(3)])
    point = THETA if damping is None else np.append(THETA, [RAYLEIGH.alpha, RAYLEIGH.beta])

    def history(x):
        return beam.response(x[:3], RECORD, quantity, None if damping is None else x[3:])

    return np.array([history(point + 1e-30j * unit).imag / 1e-30 for unit in np.eye(point.size)])


@kinds
@arms
@dampings
@pytest.mark.parametrize(("quantity", "n_modes"), [(0, None), (3, 2)])
def test_derivatives_are_those_of_the_condensed_structure(kind, arm, damping, quantity, n_modes):
    """Gradient, tangent and gradient of e_j; by complex steps where all modes are kept."""
    beam, rng = Cantilever(arm=arm), np.random.default_rng(2)
    structure, outputs = beam.structure(THETA, damping, kind), rng.normal(size=(3, 8))
    arguments = arguments_of(structure, outputs, quantity, n_modes=n_modes)
    exact = outputs @ derivatives(beam, damping, quantity, n_modes)
    accuracy = 1e-7 if damping is RATIOS or n_modes else 1e-10
    response = linear_response(*arguments)
    weights = rng.normal(size=response.shape)
    gradient = linear_response_gradient(*arguments, weights)
    found = np.concatenate(gradient)[: len(exact)]
    assert peak_error(found, (weights * exact).sum(axis=(1, 2))) < accuracy
    directions = [rng.normal(size=a.shape) * (i == 0) for i, a in enumerate(structure.parameters())]
    moved = linear_response_tangent(*arguments, *directions)
    assert peak_error(moved, np.tensordot(directions[0], exact[:3], axes=1)) < max(accuracy, 1e-6)
    data = response + rng.normal(size=response.shape)
    of_errors = np.concatenate(linear_discrepancy_gradient(*arguments, data, np.ones(3)))[: len(exact)]
    assert peak_error(of_errors, 2.0 * ((response - data) * exact).mean(axis=2).sum(axis=1)) < accuracy


@kinds
@arms
def test_populations(kind, arm):
    """Row by row as one by one; NaN where nothing holds a node and where a mass is negative."""
    structure, rng = Cantilever(arm=arm).structure(THETA, kind=kind), np.random.default_rng(3)
    theta = THETA * rng.uniform(0.7, 1.3, (7, 3))
    theta[2], theta[4], theta[5] = [0.0, 0.8, 0.3], [1.0, 0.8, -5.0], [1.0, 0.8, 0.0]
    _, rayleigh, ratios = structure.parameters()
    outputs, weights = rng.normal(size=(3, 8)), rng.uniform(size=(7, 3))
    _, _, _, *rest = arguments_of(structure, outputs, 0)
    data = rng.normal(size=(3, RECORD.n_times))
    rows = theta, rayleigh[None], ratios[None]
    errors = linear_population_discrepancy(*rows, *rest, data)
    expected = [((linear_response(x, rayleigh, ratios, *rest) - data) ** 2).mean(axis=1) for x in theta]
    np.testing.assert_allclose(errors, expected, rtol=1e-9)
    assert np.isnan(errors).all(axis=1).tolist() == [False, False, True, False, True, False, False]
    gradients = linear_population_gradient(*rows, *rest, data, weights)[0]
    expected = [
        linear_discrepancy_gradient(x, rayleigh, ratios, *rest, data, w)[0]
        for x, w in zip(theta, weights, strict=True)
    ]
    np.testing.assert_allclose(gradients, expected, rtol=1e-8)


@kinds
def test_forces_on_masses_and_on_what_follows(kind):
    """A moment on a rotation without mass shakes the masses exactly; what has no mass is not asked for."""
    beam = Cantilever()
    structure = beam.structure(THETA, kind=kind)
    moment = Loading(RECORD.acceleration, RECORD.dt, kind="force", matrix=np.eye(8)[:, [3]])
    (mass, _, stiffness, static), picked = beam.condensed(THETA), [0, 2, 4, 6]
    condensed = LinearStructure(mass, stiffness=0.5 * (stiffness + stiffness.T), damping=RAYLEIGH)
    push = Loading(RECORD.acceleration, RECORD.dt, kind="force", matrix=static.T[:, [3]])
    for quantity in QUANTITIES:
        found = simulate(structure, moment, quantity=quantity, sensors=picked)
        assert peak_error(found, simulate(condensed, push, quantity=quantity)) < 1e-10
    with pytest.raises(ValueError, match="`sensors` must lie on mass .* forces at degree of freedom 3. Ask"):
        simulate(structure, moment)
    with pytest.raises(ValueError, match="`sensors` must lie on mass"):
        simulate(structure, moment, outputs=np.eye(8)[[1]])
    load = Loading(RECORD.acceleration, RECORD.dt, kind="force", matrix=np.eye(8)[:, [2]])
    assert simulate(structure, load).shape == (8, 120)  # a force on a mass


@pytest.fixture(scope="module")
def footbridge(data_dir):
    """Mass and the stiffness parts; 474 of 946 degrees of freedom have no mass."""
    path = data_dir / "modal" / "footbridge" / "SteelPedestrianBridgeExp.mat"
    if not path.is_file():
        pytest.skip("the matrices of the footbridge are not there")
    found = loadmat(path)
    parts = [found[name] for name in found if name.startswith("K_") and name != "K_whole"]
    whole = [a.toarray() if sparse.issparse(a) else a for a in (found["M0"], *parts)]
    mass, *parts = (np.array(a, dtype=float) for a in whole)
    return mass, parts


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(np.asarray, id="dense", marks=pytest.mark.slow),
        pytest.param(sparse.csc_array, id="sparse"),
    ],
)
def test_frequencies_of_a_footbridge(kind, footbridge, reference_dir):
    """The published ones of the nominal model, to 1e-6; what has no mass follows."""
    mass, parts = footbridge
    structure = LinearStructure(kind(mass), stiffness=kind(sum(parts)), damping=RAYLEIGH)
    assert (structure.n_dof, structure.n_modes) == (946, 472)
    published = json.loads((reference_dir / "modal_published.json").read_text())["footbridge"]
    expected = published["nominal"]["frequencies_hz"]
    modes = structure.modes(8)
    np.testing.assert_allclose(modes.natural_frequencies, expected, rtol=1e-6)
    empty = np.flatnonzero(mass.diagonal() == 0.0)
    residual = abs((structure.stiffness @ modes.mode_shapes)[empty])
    assert residual.max() < 1e-9 * abs(structure.stiffness @ modes.mode_shapes).max()
