"""Structures with massless degrees of freedom: their modes, and what is refused by its degrees of freedom."""

import numpy as np
import pytensor.tensor as pt
import pytest
from scipy.linalg import eigh

from pymc_features import AffineStructure, LinearStructure, RayleighDamping, response, simulate
from pymc_features.algebra import natural_modes
from pymc_features.simulators.linear.dense import dense_modes
from pymc_features.simulators.linear.system import admissible_modes
from support.graphs import PLAIN
from support.linear import UNDAMPED, spring_chain
from support.massless import KINDS, RAYLEIGH, Cantilever
from support.refusals import refusals
from support.structures import noise_record, peak_error

THETA = np.array([1.0, 0.8, 0.3])
kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
arms = pytest.mark.parametrize("arm", [0.0, 0.4])


@kinds
@arms
def test_modes_are_those_of_the_condensed_structure(kind, arm):
    """Frequencies, shapes, participation and ratios; what has no mass follows: N' K phi = 0."""
    beam = Cantilever(6, arm)
    structure, (mass, _, stiffness, static) = beam.structure(THETA, kind=kind), beam.condensed(THETA)
    values, vectors = eigh(stiffness, mass)
    modes = structure.modes()
    np.testing.assert_allclose(modes.angular_frequencies, np.sqrt(values), rtol=1e-11)
    expected = static @ vectors
    signs = np.sign((expected * modes.mode_shapes).sum(axis=0))
    assert peak_error(modes.mode_shapes * signs, expected) < 1e-10
    whole = beam.matrices(THETA)[0]
    np.testing.assert_allclose(modes.mode_shapes.T @ whole @ modes.mode_shapes, np.eye(6), atol=1e-12)
    total = beam.influence @ whole @ beam.influence
    assert modes.effective_modal_masses.sum() == pytest.approx(total, rel=1e-12)
    few = structure.modes(2)
    np.testing.assert_allclose(few.angular_frequencies, np.sqrt(values[:2]), rtol=1e-11)
    assert peak_error(few.mode_shapes, modes.mode_shapes[:, :2]) < 1e-9
    rayleigh = RAYLEIGH.alpha + RAYLEIGH.beta * values
    np.testing.assert_allclose(2.0 * modes.damping_ratios * np.sqrt(values), rayleigh, rtol=1e-10)


@kinds
def test_a_raft_keeps_its_rigid_body(kind):
    """A floating chain, every second node without mass: one frequency is exactly zero."""
    mass = kind(np.diag([1.0, 0.0, 2.0, 0.0, 1.0, 0.0, 3.0]))
    raft = LinearStructure(
        mass, stiffness=kind(spring_chain(7, 100.0, free=True).toarray()), damping=UNDAMPED
    )
    modes = raft.modes()
    assert modes.angular_frequencies[0] == 0.0 and modes.angular_frequencies[1] > 1.0
    np.testing.assert_allclose(modes.mode_shapes[:, 0], 1.0 / np.sqrt(7.0), rtol=1e-9)
    assert raft.modes(1).angular_frequencies[0] == 0.0
    assert simulate(raft, noise_record(30, seed=1)).shape == (7, 30)


def test_inside_a_model():
    """All modes by default, and NaN where a node is held by nothing."""
    beam, record = Cantilever(), noise_record(30)
    theta = pt.vector("theta", shape=(3,))
    mu = response(beam.structure(THETA).with_parameters(theta), record)
    expected = simulate(beam.structure(THETA), record).values
    assert peak_error(mu.eval({theta: THETA}, mode=PLAIN), expected) < 1e-12
    assert np.isnan(mu.eval({theta: [0.0, 0.8, 0.3]}, mode=PLAIN)).all()


def chain_of(*masses):
    """Three nodes in a row, the last two held by the first alone."""
    return {
        "mass": np.diag(masses),
        "stiffness": spring_chain(len(masses), 100.0).toarray(),
        "damping": UNDAMPED,
    }


FLOATING = np.array(
    [[5.0, 0.0, 0.0], [0.0, 2.0, -2.0], [0.0, -2.0, 2.0]]
)  # 1 and 2 are held by each other alone
REFUSED = {  # what is said: what is given
    "where there is no mass, got no stiffness for a motion of degrees of freedom 1 and 2. Give it mass": {
        "mass": np.diag([1.0, 0.0, 0.0]),
        "stiffness": FLOATING,
        "damping": UNDAMPED,
    },
    "got negative stiffness for a motion of degree of freedom 1. Give it mass": {
        "mass": np.diag([1.0, 0.0]),
        "stiffness": np.diag([2.0, -1.0]),
        "damping": UNDAMPED,
    },
    "a motion of degrees of freedom 1, 2, 3, 4, 5, 6 and 2 others": {
        "mass": np.diag([1.0] + [0.0] * 8),
        "stiffness": np.block(
            [[np.eye(1), np.zeros((1, 8))], [np.zeros((8, 1)), spring_chain(8, 5.0, free=True).toarray()]]
        ),
        "damping": UNDAMPED,
    },
    r"`stiffness` must have no negative eigenvalue, got (omega\^2 = -33.33|a negative pivot)": {
        "mass": np.diag([1.0, 0.0]),
        "stiffness": np.array([[0.0, 10.0], [10.0, 3.0]]),
        "damping": UNDAMPED,
    },
    "`damping` must be zero where there is no mass, .* dashpots at degree of freedom 1. Add mass, or pass": (
        chain_of(1.0, 0.0, 2.0) | {"damping": np.diag([0.0, 1.0, 0.0])}
    ),
    "`damping` must not feed energy into any motion": (
        chain_of(1.0, 0.0, 2.0) | {"damping": np.diag([1.0, 0.0, -1.0])}
    ),
}


def test_refused_numbers_of_modes():
    structure = Cantilever().structure(THETA)
    with pytest.raises(ValueError, match="`n_modes` must be an integer from 1 to 4, got 5. Leave it out"):
        simulate(structure, noise_record(20), n_modes=5)
    mass, _, stiffness = Cantilever().matrices(THETA)
    with pytest.raises(ValueError, match="`mass` must be semi-definite, of rank 5 at least, got one of ran"):
        natural_modes(mass, stiffness, 5)
    with pytest.raises(ValueError, match="got a matrix with a negative eigenvalue"):
        natural_modes(-mass, stiffness, 1)


@kinds
@refusals("given", REFUSED)
def test_refusals(kind, given, match):
    given = {name: a if a is UNDAMPED else kind(a) for name, a in given.items()}
    with pytest.raises(ValueError, match=match):
        LinearStructure(**given)


@kinds
def test_mechanisms_are_no_rounding(kind):
    """Three nodes without mass that move together in some direction unheld: a pivot of rounding errors."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        strain = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-2.0, 2.0)
        stiffness = np.zeros((4, 4))
        stiffness[0, 0], stiffness[1:, 1:] = 7.0, strain.T @ strain
        mass = np.diag([1.0, 0.0, 0.0, 0.0])
        with pytest.raises(
            ValueError, match="got no stiffness for a motion of degrees of freedom 1, 2 and 3"
        ):
            LinearStructure(kind(mass), stiffness=kind(stiffness), damping=UNDAMPED)
        if kind is np.asarray:
            assert not dense_modes(mass, stiffness, np.empty(1), np.empty((1, 4)))
        else:
            assert admissible_modes(kind(mass), kind(stiffness), 1) == (None,)


@kinds
def test_damping_where_there_is_no_mass(kind):
    """A multiple of K is taken, and damps as Rayleigh's; of a model every term must be one."""
    given, record = chain_of(1.0, 0.0, 2.0), noise_record(60)
    mass, stiffness = kind(given["mass"]), kind(given["stiffness"])
    by_matrix = LinearStructure(mass, stiffness=stiffness, damping=0.2 * mass + 0.003 * stiffness)
    rayleigh = LinearStructure(mass, stiffness=stiffness, damping=RayleighDamping(0.2, 0.003))
    assert peak_error(simulate(by_matrix, record), simulate(rayleigh, record)) < 1e-12
    softer = dict(stiffness=stiffness, damping=0.003 * stiffness, stiffness_terms=[0.5 * stiffness])
    theta = pt.vector("theta", shape=(1,))
    with pytest.raises(
        ValueError, match="`damping` must be zero where there is no mass, .* at degree of freedom 1"
    ):
        AffineStructure(mass, **softer).with_parameters(theta)
    AffineStructure(mass, **softer, damping_terms=[0.0015 * stiffness]).with_parameters(theta)
    mass, stiffness = kind(np.diag([1.0, 0.0])), kind(np.diag([3.0, 0.0]))
    unheld = dict(stiffness=stiffness, damping=UNDAMPED, theta=theta)
    with pytest.raises(ValueError, match="`stiffness` must hold every .*, got a row of zeros for 1. Remove"):
        AffineStructure(mass, stiffness_terms=[stiffness], **unheld)
    AffineStructure(mass, stiffness_terms=[kind(np.eye(2))], **unheld)  # a term holds what K does not
