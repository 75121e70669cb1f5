"""Populations of large sparse structures in a reduced basis: what it does not hold is noticed."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh

from pymc_features import AffineStructure, ModalDamping
from pymc_features.modal.structural_modes import AT_REST
from pymc_features.simulators import FAMILIES, Outputs
from pymc_features.simulators.linear.arguments import LinearParameters
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.modal import linear
from pymc_features.simulators.modal.perturbation import Cotangent
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.straight import Loading

SIDES = 20, 15  # of a membrane on springs
APPENDAGE = 100  # a degree of freedom that hangs on one spring
M = 4
WANTED = Outputs(np.array([5, 77, 200]), M, 0)
NEAR = 0.05 * np.random.default_rng(3).standard_normal((40, 5))
NEAR[:, 4] = np.abs(NEAR[:, 4])
APART = 2.3e4  # ratio of both directions at which the second and third frequency of a square would meet


def membrane(massless=False):
    """n = 300: theta scale the springs of both directions, the bedding, an appendage's spring, and masses."""
    n = SIDES[0] * SIDES[1]
    keep = sparse.diags_array((np.arange(n) != APPENDAGE).astype(float))
    along, across = (
        sparse.diags_array([np.full(k, 2.0), -np.ones(k - 1), -np.ones(k - 1)], offsets=[0, 1, -1])
        for k in SIDES
    )
    terms = [
        keep @ (1e4 * sparse.kron(along, sparse.eye_array(SIDES[1]))) @ keep,
        keep @ (APART * sparse.kron(sparse.eye_array(SIDES[0]), across)) @ keep,
        50.0 * sparse.diags_array(np.linspace(0.0, 1.0, n)) @ keep,
        2e4 * (sparse.eye_array(n) - keep),
    ]
    terms = [term.tocsc() for term in terms]
    masses = np.ones(n)
    masses[7:n:9] = 0.0 if massless else 1.0
    more = sparse.diags_array(masses * np.linspace(0.0, 1.0, n)).tocsc()
    return AffineStructure(
        sparse.diags_array(masses).tocsc(),
        stiffness=sum(terms[1:], terms[0]),
        damping=ModalDamping(0.01),
        stiffness_terms=[*terms, None],
        mass_terms=[None] * 4 + [more] if massless else (),
        theta=np.zeros(5),
    )


def population(structure, thetas):
    _, rayleigh, ratios = structure.parameters()
    return LinearParameters(thetas, rayleigh[None], ratios[None], *structure.constants(AT_REST))


def in_full(function, *args, **kwargs):
    """The same without any basis."""
    KNOWN.forget()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KNOWN, "of", lambda *given, **settings: None)
        return function(*args, **kwargs)


@pytest.fixture(autouse=True)
def begin_anew():
    KNOWN.forget()


def dense_frequencies(structure, theta):
    """Independent of all factorisations of this package."""
    own = structure.with_parameters(theta)
    values = eigh(own.stiffness.toarray(), own.mass.toarray(), eigvals_only=True)
    return np.sqrt(values[:M]) / (2.0 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize("massless", [False, True], ids=["constant mass", "mass that varies, not everywhere"])
def test_modes_are_those_of_each_by_itself(massless):
    """Frequencies to 1e-11, shapes to 1e-6, signs included; most in the basis; order hardly counts."""
    structure, thetas = membrane(massless), NEAR.copy()
    thetas[17, 0] = -3.0  # no structure
    parameters = population(structure, thetas)
    found = linear.linear_population_modes(parameters, WANTED)
    [known] = KNOWN.entries
    assert known.solved <= 24 and known.found >= 16
    expected = in_full(linear.linear_population_modes, parameters, WANTED)
    backwards = linear.linear_population_modes(population(structure, thetas[::-1]), WANTED)
    for result in (found, [x[::-1] for x in backwards]):
        np.testing.assert_allclose(result[0], expected[0], rtol=1e-11)
        np.testing.assert_allclose(result[1], expected[1], rtol=0, atol=1e-6 * np.nanmax(abs(expected[1])))
    assert np.isnan(found[0]).sum() == M and np.isnan(found[0][17]).all()
    KNOWN.forget()
    np.testing.assert_array_equal(linear.linear_population_modes(parameters, WANTED)[1], found[1])


def responses(structure, thetas, quantity=0):
    """What the kernels of populations take: forces at two places, sensors, the lowest modes, data."""
    family, n = FAMILIES["linear"], structure.n_dof
    rng = np.random.default_rng(0)
    places = np.zeros((n, 2))
    places[[40, 222], [0, 1]] = 1e3
    loads = Loading(rng.standard_normal((2, 200)), 0.02, kind="force", matrix=places)
    _, rayleigh, ratios = structure.parameters()
    rows = family.rows(np.array([5, 77, 200]), n).toarray()
    inputs = thetas, rayleigh[None], ratios[None], *structure.constants(loads), structure.excitation(loads)
    given = family.assemble((*inputs, 0.02, 1, 1, NO_DIRECT, rows, M), quantity)
    return given, 1e-4 * rng.standard_normal((3, 200)), family.kernels


def test_gradients_are_those_of_each_by_itself():
    """To 1e-6, though the basis has other shapes only; without the check of derivatives it would not be."""
    parameters, rng = population(membrane(), NEAR), np.random.default_rng(1)
    _, shapes, _ = linear.linear_population_modes(parameters, WANTED)
    weights = Cotangent(rng.normal(size=(40, M)), shapes, rng.normal(size=(40, M)))  # of phi' phi / 2
    found = linear.linear_modes_gradient(parameters, WANTED, weights)
    assert KNOWN.entries[0].found > 40
    expected = in_full(linear.linear_modes_gradient, parameters, WANTED, weights)
    assert gradient_error(found[0], expected[0]) < 1e-6


def gradient_error(found, expected):
    """Largest of all structures, of the largest derivative."""
    return (abs(found - expected).max(axis=1) / abs(expected).max(axis=1)).max()


@pytest.mark.slow
@pytest.mark.parametrize("massless", [False, True])
def test_misfits_under_forces(massless):
    """e_j to 1e-8 and their gradients to 1e-6, of particles together and of one alone."""
    structure = membrane(massless)
    given, data, kernels = responses(structure, NEAR)
    weights = np.ones((40, 3, 1))
    values = kernels["population_discrepancy"](*given, data)
    gradients = kernels["population_gradient"](*given, data, weights)
    known = KNOWN.entries[0]
    assert known.found > 40
    before, one = known.found, (given[0].one_of(3), *given[1:])
    alone = kernels["discrepancy"](*one, data)
    assert known.found == before + 1  # in the basis that is there
    np.testing.assert_allclose(alone, values[3], rtol=1e-8)
    np.testing.assert_allclose(in_full(kernels["population_discrepancy"], *given, data), values, rtol=1e-8)
    expected = in_full(kernels["population_gradient"], *given, data, weights)
    assert gradient_error(gradients[0], expected[0]) < 1e-6


def frame(storeys=40, lines=4):
    """n = 480: a plane frame, u, v and rotation of each joint; theta scale its columns and its beams."""
    joint = np.arange((storeys + 1) * lines).reshape(storeys + 1, lines)
    bending = np.array([[12.0, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    stretch = np.array([[1.0, -1.0], [-1.0, 1.0]])

    def members(ends, along, axial, rigidity, turn):
        total = sparse.lil_array((3 * joint.size, 3 * joint.size))
        for i, j in 3 * np.stack(ends, axis=-1).reshape(-1, 2):
            total[np.ix_([i + along, j + along], [i + along, j + along])] += axial * stretch
            places, sign = [i + 1 - along, i + 2, j + 1 - along, j + 2], np.array([1.0, turn, 1.0, turn])
            total[np.ix_(places, places)] += rigidity * bending * np.outer(sign, sign)
        return total.tocsc()[3 * lines :, 3 * lines :]

    terms = [
        members((joint[:-1], joint[1:]), 1, 6e9, 5e7, -1.0),
        members((joint[1:, :-1], joint[1:, 1:]), 0, 1e9, 2e6, 1.0),
    ]
    return AffineStructure(
        sparse.diags_array(np.tile([2e4, 2e4, 1e3], storeys * lines)).tocsc(),
        stiffness=sum(terms[1:], terms[0]),
        damping=ModalDamping(0.01),
        stiffness_terms=terms,
        theta=np.zeros(2),
    )


def test_what_little_is_new_of_stiff_motions_joins():
    """Where members are stiff, a part of a shape that is small by its length has much of its energy.

    Measured by its length it would stay outside, where the residuals find it: 64 structures are solved then.
    """
    structure, thetas = frame(), np.random.default_rng(0).uniform(-0.4, 0.4, (160, 2))
    found = linear.linear_population_modes(population(structure, thetas), WANTED)
    [known] = KNOWN.entries
    assert known.solved <= 12
    np.testing.assert_allclose(found[0][-1], dense_frequencies(structure, thetas[-1]), rtol=1e-9)


@pytest.mark.parametrize("stiff, is_given_up", [(1e8, False), (1e10, True)])
def test_rounding_above_the_limit_ends_the_search(stiff, is_given_up):
    """Of a chain whose masses are tied in pairs: its basis is right, and residuals cannot show it."""
    n = 240
    ends, ties = np.ones(n - 1), np.ones(n - 1)
    ties[1::2] = 0.0
    diagonal = np.full(n, 2.0)
    terms = [
        1e4 * sparse.diags_array([diagonal, -ends, -ends], offsets=[0, 1, -1]),
        stiff * sparse.diags_array([np.ones(n), -ties, -ties], offsets=[0, 1, -1]),
        10.0 * sparse.diags_array(np.linspace(0.0, 1.0, n)),
    ]
    structure = AffineStructure(
        sparse.eye_array(n).tocsc(),
        stiffness=sum(terms[1:], terms[0]).tocsc(),
        damping=ModalDamping(0.01),
        stiffness_terms=[term.tocsc() for term in terms],
        theta=np.zeros(3),
    )
    thetas = np.random.default_rng(0).uniform(-0.4, 0.4, (80, 3))
    frequencies, *_ = linear.linear_population_modes(population(structure, thetas), WANTED)
    [known] = KNOWN.entries
    assert known.is_given_up == is_given_up
    assert known.solved < 40 and (known.found == 0) == is_given_up
    assert (KNOWN.of(known.given, M, 80) is None) == is_given_up
    expected = dense_frequencies(structure, thetas[-1])
    np.testing.assert_allclose(frequencies[-1], expected, rtol=1e-7 if is_given_up else 1e-8)
    with KNOWN.only(KNOWN.fix()):
        assert (KNOWN.of(known.given, M, 80) is None) == is_given_up


def test_the_same_structure_again_and_again():
    """Its modes are in the basis, what their derivatives need is not: the search for that alone ends.

    It goes on when the modes of other structures have joined.
    """
    parameters = population(membrane(), np.repeat(NEAR[:1], 40, axis=0))
    weights = Cotangent(np.ones((40, M)), np.zeros((40, M, 3)), np.zeros((40, M)))
    linear.linear_population_modes(parameters, WANTED)
    linear.linear_modes_gradient(parameters, WANTED, weights)
    [known] = KNOWN.entries
    assert known.searches[True].is_given_up and known.solved <= 20
    assert KNOWN.of(known.given, M, 40, left_out=True) is None
    assert KNOWN.of(known.given, M, 40) is known and known.searches[False].found > 30
    linear.linear_population_modes(population(membrane(), NEAR), WANTED)
    assert KNOWN.of(known.given, M, 40, left_out=True) is known


@pytest.mark.parametrize("softer", [-0.9999, -1.01], ids=["a mode that no other has", "no structure"])
def test_a_mode_that_the_basis_lacks_is_found(softer):
    """A spring so soft that its mass is the lowest mode, or gone: the inertia tells, the residuals do not."""
    structure, thetas = membrane(), NEAR.copy()
    thetas[:, 3] = 0.0
    thetas[-1, 3] = softer
    frequencies, *_ = linear.linear_population_modes(population(structure, thetas), WANTED)
    if softer < -1.0:
        assert np.isnan(frequencies[-1]).all()
        return
    np.testing.assert_allclose(frequencies[-1], dense_frequencies(structure, thetas[-1]), rtol=1e-9)
    assert frequencies[-1, 0] == pytest.approx(np.sqrt(2e4 * (1.0 + softer)) / (2.0 * np.pi))


def test_modes_that_cross():
    """Along a line on which the second and third mode, and the kept and the next one, change places."""
    structure, thetas = membrane(), np.zeros((60, 5))
    thetas[:, 0] = np.linspace(-0.3, 3.0, 60)
    frequencies, *_ = linear.linear_population_modes(population(structure, thetas), WANTED)
    assert KNOWN.entries[0].found > 30
    expected = [dense_frequencies(structure, theta) for theta in thetas[::12]]
    np.testing.assert_allclose(frequencies[::12], expected, rtol=1e-9)
    closest = np.diff(frequencies, axis=1).min(axis=0)
    assert (closest < 0.03 * frequencies[0, 0]).any()


def test_a_basis_that_is_too_small_is_noticed():
    """Of a structure a little off those it was made of: the residuals tell."""
    structure = membrane()
    linear.linear_population_modes(population(structure, 1e-3 * NEAR), WANTED)
    [known] = KNOWN.entries
    solved = known.solved
    found = linear.linear_population_modes(population(structure, 3.0 * NEAR[:1]), WANTED)
    assert known.solved == solved + 1
    np.testing.assert_allclose(found[0][0], dense_frequencies(structure, 3.0 * NEAR[0]), rtol=1e-9)
