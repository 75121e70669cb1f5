"""Linear structures: beside chains, matrix exponentials and closed forms; loads, outputs and refusals."""

import copy
import pickle

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pytensor.compile.mode import Mode
from scipy import sparse
from scipy.signal import lsim

from pymc_features import (
    AffineStructure,
    DiscrepancySimulator,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    algebra,
    response,
    simulate,
)
from pymc_features.algebra import natural_modes
from pymc_features.exceptions import SimulationWarning
from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.linear.system import is_coupled
from support.linear import UNDAMPED, affine, as_linear, noise, of_matrices, random_structure, spring_chain
from support.reference import first_order_hold, interpolated
from support.refusals import refusals
from support.straight import Loading
from support.structures import noise_record, peak_error, random_chain


def by_exponential(matrices, load, inputs, dt, static=None, *, substeps=1, stride=1):
    """All quantities of M x" + C x' + K x = load inputs without modes, first-order hold (Van Loan)."""
    mass, damping, stiffness = matrices
    drag, spring, push = (np.linalg.solve(mass, a) for a in (damping, stiffness, load))
    inputs = interpolated(inputs, substeps)
    x, v, relative = first_order_hold(drag, spring, push, inputs, dt / substeps, stride)
    absolute = relative if static is None else relative + static @ inputs[:, ::stride]
    return dict(zip(QUANTITIES, (absolute, relative, v, x), strict=True))


@pytest.mark.parametrize("seed", [0, 3, 6])
@pytest.mark.parametrize("damping", ["rayleigh", "none", "over-critical", "mixed", "heavy rayleigh"])
def test_chain_by_its_matrices(seed, damping):
    """Modes, and all quantities to 1e-12 of the peak; its damping matrix is seen to be classical."""
    chain, record = random_chain(seed, damping), noise_record(150, seed=seed)
    for linear in as_linear(chain):
        assert not is_coupled(linear.modal_damping())
        modes, expected = linear.modes(), chain.modes()
        np.testing.assert_allclose(modes.angular_frequencies, expected.angular_frequencies, rtol=1e-12)
        np.testing.assert_allclose(modes.damping_ratios, expected.damping_ratios, rtol=1e-10, atol=1e-13)
        for quantity in QUANTITIES:
            expected = simulate(chain, record, quantity=quantity)
            assert peak_error(simulate(linear, record, quantity=quantity), expected) < 1e-12


@pytest.mark.parametrize(("n_modes", "factor"), [(1, 5), (3, 0.25), (8, 1)])
def test_chain_with_truncated_modes_and_output_steps(n_modes, factor):
    chain, record = random_chain(7, "rayleigh"), noise_record(141, seed=1)
    for linear in as_linear(chain):
        for quantity in QUANTITIES:
            asked = dict(quantity=quantity, n_modes=n_modes, dt=factor * record.dt, sensors=[6, 0])
            expected = simulate(chain, record, **asked)
            found = simulate(linear, record, **asked)
            assert peak_error(found, expected) < 1e-12
            assert found.coords.equals(expected.coords) and found.attrs == expected.attrs


@pytest.mark.parametrize(
    ("damping", "n", "rank", "substeps", "stride"),
    [(1e-3, 2, 1, 1, 1), (0.1, 5, 2, 3, 1), (30.0, 8, 8, 1, 4)],
)
def test_coupled_damping_against_matrix_exponential(n, rank, damping, substeps, stride):
    """Physical coordinates, no modes: 1e-9 of the peak, light to over-critical damping."""
    matrices = random_structure(n, n, damping=damping, rank=rank)
    structure, record = of_matrices(*matrices), noise_record(150, seed=n)
    assert is_coupled(structure.modal_damping())
    ones, grid = np.ones((n, 1)), {"substeps": substeps, "stride": stride}
    load, inputs = -matrices[0] @ ones, record.acceleration[None]
    expected = by_exponential(matrices, load, inputs, record.dt, ones, **grid)
    for quantity in QUANTITIES:
        found = simulate(structure, record, quantity=quantity, dt=record.dt * stride / substeps)
        assert peak_error(found, expected[quantity]) < 1e-9


def test_a_soft_mode_is_no_rigid_body():
    """A spring 1e12 times softer than the next keeps its frequency, to the digits that K holds."""
    stiffness = np.array([[1e12 + 1.0, -1e12], [-1e12, 1e12]])
    omega = LinearStructure(np.ones(2), stiffness=stiffness, damping=UNDAMPED).modes().angular_frequencies
    np.testing.assert_allclose(omega, [np.sqrt(0.5), np.sqrt(2e12)], rtol=1e-3)


@pytest.mark.parametrize("n", [2, 100])
def test_rigid_bodies_are_found(n):
    """Chains that float with uneven springs, dense and sparse, have exactly one omega = 0."""
    springs = 10.0 ** np.random.default_rng(n).uniform(2.0, 6.0, n - 1)
    stiffness = np.diag(np.append(springs, 0.0) + np.append(0.0, springs))
    stiffness -= np.diag(springs, 1) + np.diag(springs, -1)
    for kind in (np.asarray, sparse.csc_array):
        omega = of_matrices(np.ones(n), UNDAMPED, kind(stiffness)).modes(min(n, 4)).angular_frequencies
        assert (omega == 0.0).tolist() == [True] + [False] * (omega.size - 1)


@pytest.mark.parametrize(("n", "copies", "groups"), [(60, 3, 3), (30, 20, 1)])
def test_sparse_solver_finds_every_copy(n, copies, groups):
    """Equal frequencies many times over; of twenty copies Lanczos alone misses some (seen by inertia)."""
    one = spring_chain(n, 100.0)
    lowest = np.sqrt(np.linalg.eigvalsh(one.toarray()))[:groups]
    structure = of_matrices(np.ones(n * copies), UNDAMPED, sparse.block_diag([one] * copies).tocsc())
    modes = structure.modes(groups * copies)
    np.testing.assert_allclose(modes.angular_frequencies, np.repeat(lowest, copies), rtol=1e-10)
    shapes = modes.mode_shapes
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(groups * copies), atol=1e-9)


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_matrix], ids=["dense", "sparse"])
@pytest.mark.parametrize("alpha", [0.0, 0.4])
def test_rigid_body_under_a_force(kind, alpha):
    """Two free masses, step force on the first: the centre drifts, the spring oscillates; closed forms."""
    (m1, m2), k, force = (1.0, 3.0), 50.0, 8.0
    stiffness = kind(k * np.array([[1.0, -1.0], [-1.0, 1.0]]))
    structure = LinearStructure([m1, m2], stiffness=stiffness, damping=RayleighDamping(alpha, 0.0))
    loading = Loading(np.full(400, force), 0.01, kind="force", matrix=[[1.0], [0.0]])
    t = loading.time
    omega = structure.modes().angular_frequencies
    assert omega[0] == 0.0 and omega[1] == pytest.approx(np.sqrt(k * (1 / m1 + 1 / m2)), rel=1e-14)
    drift = (t / alpha - (1.0 - np.exp(-alpha * t)) / alpha**2) if alpha else 0.5 * t**2
    centre = force / (m1 + m2) * drift  # of mass
    damped = np.sqrt(omega[1] ** 2 - 0.25 * alpha**2)
    decay = np.exp(-0.5 * alpha * t)
    stretch = force / m1 / omega[1] ** 2
    stretch = stretch * (1.0 - decay * (np.cos(damped * t) + 0.5 * alpha / damped * np.sin(damped * t)))
    expected = centre + np.outer([m2, -m1], stretch) / (m1 + m2)
    found = simulate(structure, loading, quantity="relative_displacement")
    assert peak_error(found, expected) < 1e-12
    as_matrix = LinearStructure([m1, m2], stiffness=stiffness, damping=alpha * np.diag([m1, m2]))
    assert peak_error(simulate(as_matrix, loading, quantity="relative_displacement"), expected) < 1e-12


def test_floating_chain_with_a_dashpot():
    """A rigid-body mode in coupled damping, and one with nothing but a dashpot to the ground."""
    stiffness = spring_chain(4, 200.0, free=True).toarray()
    damping = np.diag([0.0, 5.0, 0.0, 0.0])
    values, load = noise(5, (1, 150)), np.eye(4)[:, [3]]
    expected = by_exponential((np.eye(4), damping, stiffness), load, values, 0.02)
    structure = LinearStructure(np.ones(4), stiffness=stiffness, damping=damping)
    assert is_coupled(structure.modal_damping()) and structure.modes().angular_frequencies[0] == 0.0
    loading = Loading(values, 0.02, kind="force", matrix=load)
    for quantity in QUANTITIES:
        assert peak_error(simulate(structure, loading, quantity=quantity), expected[quantity]) < 1e-9
    raft = LinearStructure([2.0], stiffness=[[0.0]], damping=[[3.0]])
    found = simulate(raft, Loading(np.full(100, 6.0), 0.02, kind="force"), quantity="relative_velocity")
    assert peak_error(found[0], 2.0 * (1.0 - np.exp(-1.5 * found["time"]))) < 1e-12


def test_large_sparse_structure():
    """Twenty modes of 400: frequencies by the closed form to 1e-11, responses by dense modes to 1e-8."""
    n, k, kept = 400, 1e8, 20
    stiffness = spring_chain(n, k)
    mass = sparse.eye_array(n)
    j = np.arange(1, kept + 1)
    exact = 2.0 * np.sqrt(k) * np.sin((2 * j - 1) * np.pi / (2 * (2 * n + 1)))
    structure = LinearStructure(mass, stiffness=stiffness, damping=ModalDamping(np.full(kept, 0.02)))
    np.testing.assert_allclose(structure.modes(kept).angular_frequencies, exact, rtol=1e-11)
    dense = LinearStructure(np.ones(n), stiffness=stiffness.toarray(), damping=ModalDamping(0.02))
    record = noise_record(300, seed=7)
    for quantity in ("absolute_acceleration", "relative_displacement"):
        asked = dict(quantity=quantity, n_modes=kept, sensors=[0, 199, 399])
        assert peak_error(simulate(structure, record, **asked), simulate(dense, record, **asked)) < 1e-8
    damping = 0.5 * mass + 1e-4 * stiffness
    damping[n - 1, n - 1] += 200.0  # a dashpot at the top couples the modes
    sparse_c = LinearStructure(mass, stiffness=stiffness, damping=damping)
    assert is_coupled(sparse_c.modal_damping(kept))
    dense_c = LinearStructure(np.ones(n), stiffness=stiffness.toarray(), damping=damping.toarray())
    dense_c._modes = dense._modes  # found above
    asked = dict(n_modes=kept, sensors=[399])
    assert peak_error(simulate(sparse_c, record, **asked), simulate(dense_c, record, **asked)) < 1e-8


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("matrix", [None, [[0.0, 1.0], [2.0, 0.0], [0.0, -1.0]]])
def test_forces_against_lsim(coupled, matrix):
    mass, damping, stiffness = random_structure(10, 3)
    damping = damping if coupled else 0.2 * mass + 1e-3 * stiffness
    loading = Loading(noise(10, (3 if matrix is None else 2, 300)), 0.02, kind="force", matrix=matrix)
    inverse = np.linalg.inv(mass)
    zero, eye = np.zeros((3, 3)), np.eye(3)
    system = np.block([[zero, eye], [-inverse @ stiffness, -inverse @ damping]])
    push = inverse @ (eye if matrix is None else np.array(matrix))
    entry = np.vstack([np.zeros_like(push), push])
    structure = LinearStructure(mass, stiffness=stiffness, damping=damping)
    for quantity, rows, through in (
        ("absolute_acceleration", system[3:], push),
        ("relative_acceleration", system[3:], push),
        ("relative_displacement", np.hstack([eye, zero]), 0.0 * push),
    ):
        _, expected, _ = lsim((system, entry, rows, through), loading.values.T, loading.time)
        assert peak_error(simulate(structure, loading, quantity=quantity), expected.T) < 1e-9


def test_supports_that_move_together_are_one_base():
    chain, record = random_chain(4, "rayleigh"), noise_record(150, seed=11)
    mass, damping, stiffness = chain.matrices()
    share = np.linspace(0.1, 0.8, 5)
    two = LinearStructure(
        mass, stiffness=stiffness, damping=damping, influence=np.column_stack([share, 1.0 - share])
    )
    loading = Loading([record.acceleration] * 2, record.dt, name="twins")
    assert two.n_supports == 2 and two.modes().participation_factors.shape == (5, 2)
    for quantity in QUANTITIES:
        for n_modes in (2, 5):
            asked = dict(quantity=quantity, n_modes=n_modes, dt=0.01)
            found = simulate(two, loading, **asked)
            assert peak_error(found, simulate(chain, record, **asked)) < 1e-12
    assert found.attrs == {"units": "m", "record": "twins"}


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_array], ids=["dense", "sparse"])
@pytest.mark.parametrize("n_modes", [None, 2])
def test_outputs_are_combinations(kind, n_modes):
    """S x: drifts of a chain, of coupled damping, of any quantity, by hand."""
    chain, record = random_chain(4, "rayleigh"), noise_record(150, seed=12)
    drifts = np.eye(5) - np.eye(5, k=-1)
    for structure in (chain, *as_linear(chain), of_matrices(*random_structure(12, 5))):
        for quantity in QUANTITIES:
            asked = dict(quantity=quantity, n_modes=n_modes)
            history = simulate(structure, record, **asked).values
            found = simulate(structure, record, outputs=kind(drifts[1:3]), **asked)
            assert peak_error(found, np.diff(history, axis=0)[:2]) < 1e-12
            assert found["sensor"].values.tolist() == [0, 1]


@pytest.mark.parametrize("kind", [np.asarray, sparse.csc_matrix], ids=["dense", "sparse"])
def test_affine_matrices(kind):
    """M, C and K are the sums; the response is that of the structure assembled by hand; nothing is copied."""
    structure, record = affine(kind), noise_record(150, seed=14)
    changed = structure.with_parameters([0.7, 0.25])
    upper = 80.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    expected = (
        np.diag([1.0, 2.25]),
        np.diag([0.5, 0.0]) + 0.007 * upper,
        np.diag([100.0, 0.0]) + 0.7 * upper,
    )
    for a, b in zip(changed.matrices(), expected, strict=True):
        np.testing.assert_allclose(a.toarray() if sparse.issparse(a) else a, b, rtol=1e-15)
    assert peak_error(simulate(changed, record), simulate(of_matrices(*expected), record)) < 1e-12
    assert structure.theta.tolist() == [1.0, 0.0] and changed.theta.tolist() == [0.7, 0.25]
    for before, after in zip(structure.constants(record)[:3], changed.constants(record)[:3], strict=True):
        assert before is after and before.shape[0] == 3
    assert peak_error(simulate(structure, record), simulate(changed, record)) > 1e-3


def test_symbolic_parameters_are_for_models():
    for symbolic in (pt.vector("theta", shape=(2,)), [pt.scalar(), 0.0]):
        structure = affine().with_parameters(symbolic)
        assert structure.is_symbolic and structure.n_dof == 2
        with pytest.raises(TypeError, match="`matrices` and `modes` must be asked of a structure of numbers"):
            structure.modes()
        assert response(structure, noise_record(150, seed=0)).type.shape[0] == 2
    assert LinearStructure([1.0], stiffness=[1.0], damping=RayleighDamping(pt.scalar(), 0.0)).is_symbolic


def test_road_to_a_model():
    """A function that simulates, in `DiscrepancySimulator`; what is no structure is rejected, not raised."""
    structure, record = affine(), noise_record(150, seed=16)
    observed = simulate(structure, record).values + 0.01

    def history(theta):
        return simulate(structure.with_parameters([theta, 0.0]), record).values

    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 1.0, default_transform=None)
        DiscrepancySimulator("y", history, theta, epsilon=1.0, observed=observed, kernel="exponential")
    logp = model.compile_logp(vars=model.observed_RVs, mode=Mode(linker="py", optimizer="fast_compile"))
    exact = np.square(history(1.1) - observed).mean(axis=1).sum()
    assert float(logp({"theta": 1.1})) == pytest.approx(-exact, rel=1e-12)
    with pytest.warns(SimulationWarning, match="must have no negative eigenvalue"):
        assert float(logp({"theta": -3.0})) == -np.inf


def test_is_a_value():
    """What was passed is copied, what is kept is read-only, copies and pickles are the same."""
    stiffness = np.array([[2.0, -1.0], [-1.0, 2.0]])
    structure = LinearStructure([1.0, 1.0], stiffness=stiffness, damping=UNDAMPED)
    stiffness[0, 0] = 99.0
    assert structure.stiffness[0, 0] == 2.0
    with pytest.raises(ValueError, match="read-only"):
        structure.stiffness[0, 0] = 1.0
    assert repr(structure) == "LinearStructure(2 degrees of freedom, dense, ModalDamping(0.0))"
    rounded = LinearStructure(np.ones(2), stiffness=[[2.0, -1.0], [-1.0 - 1e-13, 2.0]], damping=UNDAMPED)
    assert (rounded.stiffness == rounded.stiffness.T).all()
    loading = Loading([[0.0, 1.0]], 0.1, kind="force", matrix=[[1.0], [0.0]], name="push")
    assert repr(loading) == "Loading('push', force, 1 x 2 samples, dt=0.1 s)"
    for same in (copy.deepcopy(loading), pickle.loads(pickle.dumps(loading))):
        assert (same.kind, same.name, same.dt, same.duration) == ("force", "push", 0.1, 0.1)
        np.testing.assert_array_equal(same.matrix, loading.matrix)
        with pytest.raises(ValueError, match="read-only"):
            same.values[0, 0] = 1.0
    large = LinearStructure(np.ones(50), stiffness=spring_chain(50, 100.0), damping=UNDAMPED)
    asked = dict(record=noise_record(150, seed=17), n_modes=2)
    for one in (structure, large):
        for same in (copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
            np.testing.assert_array_equal(simulate(same, **asked), simulate(one, **asked))


def test_modes_that_cannot_be_found_are_said(monkeypatch):
    """Where the count never fits: dense modes of a small structure, an error for a large one."""
    monkeypatch.setattr(algebra, "count_below", lambda *_: 10**6)
    stiffness, mass = spring_chain(40, 100.0), sparse.eye_array(40)
    omega, _ = natural_modes(mass, stiffness, 3)
    np.testing.assert_allclose(omega, np.sqrt(np.linalg.eigvalsh(stiffness.toarray())[:3]), rtol=1e-12)
    monkeypatch.setattr(algebra, "MAX_DENSE", 10)
    with pytest.raises(RuntimeError, match="1000000 modes lie below the 3 found by Lanczos iteration"):
        natural_modes(mass, stiffness, 3)


K2 = np.array([[2.0, -1.0], [-1.0, 2.0]])
GOOD = {"mass": np.eye(2), "damping": UNDAMPED, "stiffness": K2}

REFUSED_MATRICES = {  # what is said: what is given
    "`mass` must be symmetric, got 0.5 in row 0, column 1 and 0 in row 1": {"mass": [[1.0, 0.5], [0.0, 1.0]]},
    "`mass` must be positive semi-definite .* got an indefinite matr": {"mass": [[1.0, 2.0], [2.0, 1.0]]},
    "got -1 kg at degree of freedom 1. Check the signs": {"mass": [[1.0, 0.0], [0.0, -1.0]]},
    "`mass` must be positive semi-definite and not zero, got zeros": {"mass": np.zeros((2, 2))},
    r"`mass` must have shape \(2, 2\) to match `stiffness`, got \(3, 3\). Give one row": {"mass": np.eye(3)},
    "`stiffness` must be symmetric, got -1 in row 0, column 1": {"stiffness": [[2.0, -1.0], [1.0, 2.0]]},
    "`stiffness` must have no negative eigenvalue, got .* signs": {"stiffness": [[1.0, -2.0], [-2.0, 1.0]]},
    "`stiffness` must hold every degree of freedom, got a row of z": {"stiffness": [[2.0, 0.0], [0.0, 0.0]]},
    r"`stiffness` must be a square matrix, got .*\(2, 3\)": {"stiffness": [[2.0, 0.0, 1.0], [0.0, 1.0, 0.0]]},
    "`stiffness` must be finite, got NaN or infinity. Pass": {"stiffness": [[2.0, np.nan], [np.nan, 2.0]]},
    "`damping` must not feed energy into any motion, got a matrix": {"damping": [[1.0, -2.0], [-2.0, 1.0]]},
    r"`damping` must have shape \(2, 2\) to match `stiffness`, got \(3, 3\)": {"damping": np.eye(3)},
}


@refusals("changes", REFUSED_MATRICES)
def test_refused_matrices(changes, match):
    for kind in (np.asarray, sparse.csc_matrix):
        given = {name: a if a is UNDAMPED else kind(np.array(a)) for name, a in (GOOD | changes).items()}
        with pytest.raises(ValueError, match=match):
            LinearStructure(**given)


def test_a_dashpot_or_a_shared_mass_is_a_connection():
    """The rule for degrees of freedom without stiffness: refused if nothing else touches them."""
    stiffness = np.diag([2.0, 0.0])
    LinearStructure(np.eye(2), stiffness=stiffness, damping=np.diag([0.0, 1.0]))
    LinearStructure([[2.0, 0.5], [0.5, 1.0]], stiffness=stiffness, damping=UNDAMPED)
    with pytest.raises(ValueError, match="got a row of zeros for 1 and others. Remove the degree of freedom"):
        LinearStructure(np.ones(3), stiffness=np.diag([2.0, 0.0, 0.0]), damping=RayleighDamping(0.1, 0.0))


REFUSED_ARGUMENTS_VALUES = {  # what is said: what is given
    "`ratios` must have one value or .* the 2 modes, got 3": {"damping": ModalDamping([0.1] * 3)},
    r"`influence` must have shape \(2,\) or \(2, supports\), got \(3,\)": {"influence": np.ones(3)},
    "`influence` must be finite, got inf at index 1": {"influence": [1.0, np.inf]},
}
REFUSED_ARGUMENTS_TYPES = {
    "`damping` must be a matrix or a Damping, got NoneType. Pass C in N s/m": {"damping": None},
    "`damping` must be a matrix of real numbers, got ndarray": {"damping": 1j * np.eye(2)},
    "`stiffness` must be a matrix of real numbers, got str. Pass an array": {"stiffness": "K"},
    "`stiffness` must be a matrix of real numbers": {"stiffness": sparse.eye_array(2) * 1j},
    "`influence` must be an array of numbers, got str": {"influence": "all"},
    "got TensorVariable. .* they cannot be random": {"influence": pt.vector()},
    "what is random goes into the `theta` of an AffineStructure": {"mass": pt.vector()},
}


@refusals("changes", REFUSED_ARGUMENTS_VALUES, REFUSED_ARGUMENTS_TYPES)
def test_refused_arguments(changes, error, match):
    with pytest.raises(error, match=match):
        LinearStructure(**(GOOD | changes))


REFUSED_AFFINE_ARGUMENTS_VALUES = {  # what is said: what is given
    "must have one entry for each parameter, got 0 mass_terms, 0 damping": {"stiffness_terms": []},
    r"`stiffness_terms\[0\]` must have shape \(2, 2\)": {"stiffness_terms": [np.eye(3)]},
    r"`theta` must be 1 finite values, .*\(2,\)": {"stiffness_terms": [K2], "theta": [1.0, 2.0]},
    "one for each parameter, got NaN or infinity": {"stiffness_terms": [K2], "theta": [np.nan]},
    "`stiffness` must have no negative eigenvalue": {"stiffness_terms": [K2], "theta": [-2.0]},
    "`theta` must be 1 .* got 2 values": {"stiffness_terms": [K2], "theta": [pt.scalar()] * 2},
    "`theta` must be a list of scalars, got a vector among them": {
        "stiffness_terms": [K2] * 2,
        "theta": [pt.vector(), 1.0],
    },
}
REFUSED_AFFINE_ARGUMENTS_TYPES = {
    "`damping` must be a matrix to go with": {"stiffness_terms": [K2], "damping_terms": [K2]},
    "`theta` must be numbers or .* got str": {"stiffness_terms": [K2], "theta": "soft"},
    "`stiffness_terms` must be a sequence of matrices, got ndarray": {"stiffness_terms": K2},
}


@refusals("changes", REFUSED_AFFINE_ARGUMENTS_VALUES, REFUSED_AFFINE_ARGUMENTS_TYPES)
def test_refused_affine_arguments(changes, error, match):
    with pytest.raises(error, match=match):
        AffineStructure(**(GOOD | changes))


def test_refused_modes():
    structure = LinearStructure(**GOOD)
    for n_modes in (3, 1.5, True):
        with pytest.raises(ValueError, match=f"`n_modes` must be an integer from 1 to 2, got {n_modes}. Le"):
            structure.modes(n_modes)
    large = spring_chain(3001, 1.0)
    with pytest.raises(ValueError, match="`n_modes` must be below half of the 3001 degrees of freedom of"):
        natural_modes(sparse.eye_array(3001), large, 3001)
    few = LinearStructure(
        np.ones(3), stiffness=spring_chain(3, 1.0).toarray(), damping=ModalDamping([0.1, 0.2])
    )
    np.testing.assert_allclose(few.modes(2).damping_ratios, [0.1, 0.2], rtol=1e-14)
    with pytest.raises(ValueError, match="`ratios` must have one value or one for each of the 3 modes, g"):
        few.modes(3)


REFUSED_LOADINGS_VALUES = {  # what is said: what is given
    "`kind` must be one of support_acceleration, force, got 'wind'": ([[0.0, 1.0]], 0.1, "wind"),
    r"`values` must have shape \(input, time\) with at least 2 .* \(1, 1\). Time": ([[0.0]], 0.1),
    r"`values` must be finite, got nan at index \(0, 1\). Fill or cut": ([[0.0, np.nan]], 0.1),
    "`dt` must be positive, got 0.0. Pass the sampling interval in seconds": ([0.0, 1.0], 0.0),
    r"`matrix` must have shape \(n, 1\) .* got \(1,\)": ([0.0, 1.0], 0.1, "force", [1.0]),
    "`matrix` must be left out with support": ([0.0, 1.0], 0.1, "support_acceleration", [[1.0]]),
}
REFUSED_LOADINGS_TYPES = {
    "`values` must be an array of numbers, got str": ("push", 0.1),
    "`dt` must be a number, got 'x'": ([0.0, 1.0], "x"),
}


@refusals("arguments", REFUSED_LOADINGS_VALUES, REFUSED_LOADINGS_TYPES)
def test_refused_loadings(arguments, error, match):
    with pytest.raises(error, match=match):
        Loading(*arguments)


def test_refused_requests():
    structure, record = LinearStructure(**GOOD), noise_record(150, seed=0)
    chain = SpringMassChain([1.0, 1.0], 1.0, UNDAMPED)
    pair = Loading(np.ones((2, 5)), 0.1)
    with pytest.raises(ValueError, match="`record` must give 1 support accelerations, .* `influence`, got 2"):
        simulate(structure, pair)
    two = LinearStructure(**GOOD, influence=np.eye(2))
    with pytest.raises(ValueError, match="`record` must give 2 support accelerations, .* got 1. Pass Load"):
        simulate(two, record)
    for matrix in (None, [[1.0]]):
        force = Loading(np.ones((1, 5)), 0.1, kind="force", matrix=matrix)
        with pytest.raises(ValueError, match=r"`matrix` of the forces must have shape \(2, 1\), got .*one "):
            simulate(structure, force)
    with pytest.raises(TypeError, match="`record` must be a Record for a SpringMassChain, got Loading. Se"):
        simulate(chain, pair)
    with pytest.raises(ValueError, match="`sensors` must be left out with `outputs`, got both"):
        simulate(structure, record, sensors=[0], outputs=np.eye(2))
    with pytest.raises(ValueError, match=r"`outputs` must have shape \(s, 2\), got \(3,\). Give one row"):
        simulate(structure, record, outputs=np.ones(3))
    with pytest.raises(ValueError, match="`outputs` must be finite, got nan at index"):
        simulate(chain, record, outputs=[[np.nan, 1.0]])
    with pytest.raises(TypeError, match="`record` must be a Record, got ndarray"):
        simulate(structure, np.ones(4))


def test_negative_stiffness_beside_stiff_elements_is_found():
    """A soft negative spring below a stiff one: omega^2 = -175 (rad/s)^2 where the largest is 2e12."""
    stiff = 1e12
    negative = np.array(
        [[stiff - 500.0, -stiff, 0.0], [-stiff, stiff + 1000.0, -1000.0], [0.0, -1000.0, 1000.0]]
    )
    structure = LinearStructure(np.ones(3), stiffness=negative, damping=UNDAMPED)
    with pytest.raises(ValueError, match=r"no negative eigenvalue, got omega\^2 = -17\d"):
        simulate(structure, noise_record(150, seed=0))
