"""Structures from functions that assemble matrices: the terms, what is not affine, parameters by name."""

import numpy as np
import pymc as pm
import pytest
from scipy import sparse

import pymc_features as pmf
from pymc_features import AffineStructure, RayleighDamping

DAMPING = RayleighDamping(0.1, 0.001)
NOMINAL = {"lower": 3.1e7 / 3, "upper": 2.3e7 / 7, "mass": 811.3, "dashpot": 0.0}
FIXED = np.array([[0.0, 0.0], [0.0, 50.0]])
LOWER, UPPER = np.diag([1.0, 0.0]), np.array([[1.0, -1.0], [-1.0, 1.0]])
SHAPE = np.array([[2.0, 0.5], [0.5, 1.0]])


def frame(lower, upper, mass, dashpot):
    """Two storeys; the dashpot is on the top."""
    in_parts = 0.1 * upper * UPPER + 0.7 * upper * UPPER + 0.2 * upper * UPPER + lower * LOWER
    return mass * SHAPE + FIXED, dashpot * np.diag([0.0, 1.0]) + 1e4 * UPPER, in_parts


def as_sparse(**values):
    """The same in sparse matrices."""
    return tuple(sparse.coo_matrix(a) for a in frame(**values))


@pytest.mark.parametrize("build", [frame, as_sparse])
def test_terms_are_those_made_by_hand(build):
    structure = AffineStructure.from_matrices(build, NOMINAL, influence=[1.0, 0.5])
    by_hand = AffineStructure(
        FIXED,
        stiffness=np.zeros((2, 2)),
        damping=1e4 * UPPER,
        stiffness_terms=[LOWER, UPPER, None, None],
        mass_terms=[None, None, SHAPE, None],
        damping_terms=[None, None, None, np.diag([0.0, 1.0])],
        influence=[1.0, 0.5],
        theta=list(NOMINAL.values()),
    )
    assert sparse.issparse(structure.stiffness) == (build is as_sparse)
    for theta in (list(NOMINAL.values()), [1e7, 4e7, 500.0, 2e3]):
        sets = structure.with_parameters(theta).matrices(), by_hand.with_parameters(theta).matrices()
        for found, expected in zip(*sets, strict=True):
            found = found.toarray() if sparse.issparse(found) else found
            np.testing.assert_allclose(found, expected, rtol=1e-13)
    for found, expected in zip(structure._terms, by_hand._terms, strict=True):
        entries = [a.toarray() if sparse.issparse(a) else a for a in found.matrices()]
        for one, other in zip(entries, expected.matrices(), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
            assert ((one == 0.0) == (other == 0.0)).all()  # what rounding leaves would be a mass
    np.testing.assert_array_equal(structure.influence, [1.0, 0.5])


def test_damping_given_replaces_that_of_the_function():
    without = {name: NOMINAL[name] for name in ("lower", "upper", "mass")}
    found = AffineStructure.from_matrices(
        lambda lower, upper, mass: frame(lower, upper, mass, 3.0), without, damping=DAMPING
    )
    mass, damping, stiffness = found.matrices()
    np.testing.assert_allclose(damping, 0.1 * mass + 0.001 * stiffness, rtol=1e-13)
    pair = AffineStructure.from_matrices(
        lambda k: (np.eye(2), k * UPPER + FIXED), {"k": 10.0}, damping=DAMPING
    )
    assert pair.n_dof == 2
    with pytest.raises(ValueError, match="`parameters` must change a matrix each, got 'dashpot'"):
        AffineStructure.from_matrices(frame, NOMINAL, damping=DAMPING)


def test_parameters_by_name():
    """In a model too, in any order; posteriors of the likelihood need no order to be remembered."""
    structure = AffineStructure.from_matrices(frame, NOMINAL)
    assert structure.parameter_names == tuple(NOMINAL)
    mixed = dict(reversed(NOMINAL.items())) | {"lower": 1e7}
    np.testing.assert_array_equal(structure.with_parameters(mixed).theta, [1e7, 2.3e7 / 7, 811.3, 0.0])
    with pm.Model():
        lower = pm.Uniform("lower", 1e7, 5e7)
        changed = structure.with_parameters(NOMINAL | {"lower": lower})
        found = pmf.modes(changed).frequencies.eval({lower: 1e7})
    expected = structure.with_parameters(mixed).modes().natural_frequencies
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    with pytest.raises(ValueError, match="`theta` must have the parameters lower, upper, mass, dashpot, got"):
        structure.with_parameters({"lower": 1e7})
    with pytest.raises(ValueError, match="`theta` must have the parameters no names: pass a vector"):
        AffineStructure([1.0], stiffness=[1.0], damping=DAMPING, stiffness_terms=[[1.0]]).with_parameters(
            {"lower": 1e7}
        )


def cantilever(E, h, b, m):  # noqa: N803
    """A mass on a cantilever of 2 m beside a spring: 3 E I / L^3, I = b h^3 / 12."""
    return [[m, 0.0], [0.0, m]], [[3.0 * E * b * h**3 / 12 / 8, 0.0], [0.0, 1e3]]


@pytest.mark.parametrize(
    "build, parameters, message",
    [
        (cantilever, {"h": 0.2, "m": 5.0}, "stiffness in which h enters otherwise"),
        (cantilever, {"E": 2e11, "b": 0.1, "m": 5.0}, "stiffness in which E and b act on each other"),
    ],
    ids=["cube", "product"],
)
def test_what_is_not_affine_is_refused_by_name(build, parameters, message):
    rest = {"E": 2e11, "h": 0.2, "b": 0.1, "m": 5.0}
    advice = r".*the sum misses the entry in row 0, column 0 by .*\(E I, not a height\), or run .* Externa"
    with pytest.raises(ValueError, match=f"`build` must return matrices that are sums .*{message}{advice}"):
        AffineStructure.from_matrices(lambda **x: build(**rest | x), parameters, damping=DAMPING)


def of_frequencies(k):
    """Rayleigh damping by ratios at sqrt(k), which k does not enter linearly."""
    stiffness, omega = k * UPPER + FIXED, np.sqrt(k)
    return np.eye(2), 0.02 * omega * np.eye(2) + 0.02 / omega * stiffness, stiffness


def test_damping_that_cannot_be_taken():
    with pytest.raises(ValueError, match="a damping in which k enters otherwise.*pass `damping`"):
        AffineStructure.from_matrices(of_frequencies, {"k": 100.0})
    AffineStructure.from_matrices(of_frequencies, {"k": 100.0}, damping=DAMPING)
    with pytest.raises(ValueError, match=r"`damping` must be given if `build` returns \(M, K\)"):
        AffineStructure.from_matrices(lambda k: (np.eye(2), k * UPPER + FIXED), {"k": 10.0})


@pytest.mark.parametrize(
    "build, parameters, message",
    [
        (
            lambda k: None,
            {"k": 1.0},
            r"`build` must be a function that returns \(M, C, K\) or \(M, K\), got N",
        ),
        (lambda k: (np.eye(2), "stiff"), {"k": 1.0}, "finite square matrices, got str as stiffness"),
        (lambda k: (np.eye(2), np.ones((2, 3))), {"k": 1.0}, r"got shape \(2, 3\) for stiffness"),
        (lambda k: (np.eye(2), np.eye(2) * np.nan), {"k": 1.0}, "got NaN or infinity in stiffness"),
        (lambda k: (np.eye(int(k)), np.eye(int(k))), {"k": 2.0}, "matrices of one size.*not the degrees"),
        (frame, {}, "`parameters` must be one or more"),
        (frame, 3.0, "`parameters` must be a mapping of names to nominal values"),
        (frame, {"k": np.inf}, r"`parameters\['k'\]` must be finite, got inf"),
        (
            lambda k: None,
            {"E": 1.0},
            r"`build` must be a function of E, as in `parameters`, got one of \(k\)",
        ),
        (5, {"k": 1.0}, "`build` must be a function, got 5"),
    ],
)
def test_refusals(build, parameters, message):
    with pytest.raises((ValueError, TypeError), match=message):
        AffineStructure.from_matrices(build, parameters, damping=DAMPING)
