"""Linear structures against the chain, matrix exponentials and closed forms; sparse beside dense."""

import numpy as np
import pytest
from scipy import sparse

from pymc_features import LinearStructure, ModalDamping, RayleighDamping, simulate
from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.linear.system import is_coupled
from support.linear import UNDAMPED, as_linear, noise, of_matrices, random_structure, spring_chain
from support.reference import first_order_hold, interpolated
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
