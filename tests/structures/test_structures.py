"""Chains and damping: closed forms, a general eigen-solver, the source's numbers, and every refusal."""

import inspect

import numpy as np
import pytensor.tensor as pt
import pytest
from scipy.linalg import eigh

from pymc_features import (
    AffineStructure,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    Record,
    SpringMassChain,
    paper,
    simulate,
)
from pymc_features.simulators import FAMILIES
from pymc_features.structures import DAMPINGS, STRUCTURES, HystereticSpecimen, Structure
from support.graphs import PLAIN
from support.refusals import refusals

# One of each structure, with what its springs need
EXTRA = {
    "SpringMassChain": {},
    "HystereticChain": {"yield_displacement": 0.01, "post_yield_ratio": 0.1},
    "DuffingChain": {"cubic": 1e4},
}

CHAINS = [kind for kind in STRUCTURES if kind.__name__ in EXTRA]

UNDAMPED = ModalDamping(0.0)


def random_chain(seed):
    """Masses and springs that differ by up to a factor 50."""
    rng = np.random.default_rng(seed)
    n = rng.integers(1, 13)
    return np.exp(rng.uniform(-2.0, 2.0, n)), 1000.0 * np.exp(rng.uniform(-2.0, 2.0, n))


def assembled(mass, stiffness):
    """M and K of Eqs. (17)-(18) spring by spring, as one would with pencil and paper."""
    matrix_k = np.zeros((len(mass), len(mass)))
    for i, k in enumerate(stiffness):
        matrix_k[i, i] += k
        if i:
            matrix_k[i - 1, i - 1] += k
            matrix_k[i, i - 1] -= k
            matrix_k[i - 1, i] -= k
    return np.diag(mass), matrix_k


@pytest.mark.parametrize("n", [1, 2, 3, 10, 100])
def test_uniform_chain_has_the_closed_form_frequencies(n):
    """omega_j = 2 sqrt(k/m) sin((2j - 1) pi / (2 (2n + 1))), to 1e-12, and shapes that are sines."""
    modes = SpringMassChain(2.5, np.full(n, 1800.0), UNDAMPED).modes()
    j = np.arange(1, n + 1)
    exact = 2.0 * np.sqrt(1800.0 / 2.5) * np.sin((2 * j - 1) * np.pi / (2 * (2 * n + 1)))
    np.testing.assert_allclose(modes.angular_frequencies, exact, rtol=1e-12)
    angles = np.outer(j, (2 * j - 1) * np.pi / (2 * n + 1))
    sines = np.sin(angles) / np.sin(angles[-1])  # one at the top
    shapes = modes.mode_shapes / modes.mode_shapes[-1]
    np.testing.assert_allclose(shapes, sines, atol=1e-9 * np.abs(sines).max())


@pytest.mark.parametrize("seed", range(3))
def test_random_chain_against_a_general_eigen_solver(seed):
    """Modes that are complete, M and K, and C of both dampings, which modal ratios make diagonal."""
    mass, stiffness = random_chain(seed)
    ratios = np.random.default_rng(seed).uniform(0.0, 0.2, mass.size)
    chain = SpringMassChain(mass, stiffness, ModalDamping(ratios))
    matrix_m, matrix_k = assembled(mass, stiffness)
    modes, n = chain.modes(), mass.size
    omega, shapes, participation = modes.angular_frequencies, modes.mode_shapes, modes.participation_factors
    values, vectors = eigh(matrix_k, matrix_m)
    np.testing.assert_allclose(omega**2, values, rtol=1e-9)
    np.testing.assert_allclose(modes.natural_frequencies, omega / (2 * np.pi), rtol=1e-15)
    np.testing.assert_allclose(modes.damping_ratios, ratios, rtol=1e-15)
    vectors = vectors * np.where(vectors[-1] < 0, -1.0, 1.0)
    np.testing.assert_allclose(shapes, vectors, atol=1e-8 * np.abs(vectors).max())
    np.testing.assert_allclose(shapes.T @ matrix_m @ shapes, np.eye(n), atol=1e-12)
    np.testing.assert_allclose(participation, shapes.T @ mass, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(shapes @ participation, 1.0, rtol=1e-10)
    np.testing.assert_allclose(modes.effective_modal_masses, participation**2, rtol=1e-15)

    found_m, matrix_c, found_k = chain.matrices()
    np.testing.assert_array_equal(found_m, matrix_m)
    np.testing.assert_allclose(found_k, matrix_k, rtol=1e-14)
    modal = np.diag(2.0 * ratios * np.sqrt(values))
    np.testing.assert_allclose(vectors.T @ matrix_c @ vectors, modal, atol=1e-8 * np.sqrt(values[-1]))
    _, matrix_c, _ = SpringMassChain(mass, stiffness, RayleighDamping(0.3, 0.002)).matrices()
    np.testing.assert_allclose(matrix_c, 0.3 * matrix_m + 0.002 * matrix_k, rtol=1e-13)


@pytest.mark.parametrize(
    ("stiffness", "printed"), [(1800.0, (1.0092, 3.0051, 4.9338)), (1000.0, (0.752, 2.240, 3.677))]
)
def test_frequencies_of_the_source(stiffness, printed):
    """The printed 1.0, 3.0 and 4.9 Hz need 1800 N/m; the printed 1000 N/m gives other frequencies."""
    frequencies = paper.chain(stiffness=stiffness).modes().natural_frequencies[:3]
    digits = 4 if stiffness == 1800.0 else 3
    np.testing.assert_array_equal(frequencies.round(digits), printed)
    as_printed = (frequencies.round(1) == [1.0, 3.0, 4.9]).all()
    assert as_printed == (stiffness == 1800.0)


def test_damping_of_the_source():
    """2 % in modes 1 and 5 of the 1800 N/m chain: alpha 0.226495, beta 6.75152e-4, and back."""
    frequencies = paper.chain().modes().natural_frequencies
    damping = RayleighDamping.from_ratios(0.02, frequencies[[0, 4]])
    assert f"{damping.alpha:.6f} {damping.beta:.5e}" == "0.226495 6.75152e-04"
    back = SpringMassChain(np.ones(10), 1800.0, damping).modes().damping_ratios
    np.testing.assert_allclose(back[[0, 4]], 0.02, rtol=1e-13)
    assert (back[1:4] < 0.02).all()
    assert (back[5:] > 0.02).all()
    np.testing.assert_allclose(paper.chain().modes().damping_ratios[[0, 4]], 0.02, rtol=1e-4)
    soft = paper.chain(stiffness=1000.0).modes().damping_ratios  # negative control
    assert np.abs(soft[[0, 4]] - 0.02).max() > 0.001


@pytest.mark.parametrize(
    "ratios",
    [(0.02, 0.05), 0.03, (0.02, 0.02 / 5), (0.02, 0.1)],
    ids=["two", "one", "by mass", "by stiffness"],
)
def test_rayleigh_from_ratios_keeps_its_promise(ratios):
    """Where zeta is proportional to 1 / omega or omega, the other coefficient is no tiny negative."""
    damping = RayleighDamping.from_ratios(ratios, (1.0, 5.0))
    omega = 2 * np.pi * np.array([1.0, 5.0])
    zeta = damping.alpha / (2 * omega) + damping.beta * omega / 2
    np.testing.assert_allclose(zeta, np.broadcast_to(ratios, 2), rtol=1e-13)
    assert min(damping.alpha, damping.beta) >= 0.0


def test_scalars_stand_for_all():
    one = SpringMassChain(2.0, [100.0, 200.0, 300.0], ModalDamping(0.05))
    all_ = SpringMassChain([2.0] * 3, [100.0, 200.0, 300.0], ModalDamping([0.05] * 3))
    for a, b in zip(one.matrices(), all_.matrices(), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", CHAINS)
def test_every_chain_keeps_the_contract(kind):
    """Numbers or variables, n or one; a response; matrices and modes of the initial stiffness; a value."""
    extra = EXTRA[kind.__name__]
    structure = kind([1.0, 2.0], 100.0, UNDAMPED, **extra)
    assert isinstance(structure, Structure) and structure.family in FAMILIES
    assert (structure.n_dof, structure.is_symbolic) == (2, False)
    assert repr(structure) == f"{kind.__name__}(2 masses, ModalDamping(0.0))"
    history = simulate(structure, Record([0.0, 1.0, 0.5], 0.02), sensors=[1])
    assert history.shape == (1, 3) and np.isfinite(history).all()
    reference = SpringMassChain([1.0, 2.0], 100.0, UNDAMPED)
    for ours, theirs in zip(structure.matrices(), reference.matrices(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(
        structure.modes().angular_frequencies, reference.modes().angular_frequencies
    )
    k = pt.scalar("k")
    symbolic = kind([1.0, 2.0], k, UNDAMPED, **extra).scale_stiffness(2.0, [1])
    assert type(symbolic) is kind and symbolic.is_symbolic
    scaled = structure.scale_stiffness(2.0, [1])
    for variable, number in zip(symbolic.parameters(), scaled.parameters(), strict=True):
        value = variable.eval({k: 100.0}, mode=PLAIN) if isinstance(variable, pt.TensorVariable) else variable
        np.testing.assert_array_equal(value, number)
    assert structure.parameters()[1].tolist() == [100.0, 100.0]  # left as it was


MATRICES = assembled([1.0, 2.0, 1.5], [300.0, 200.0, 100.0])
EXAMPLES = {
    SpringMassChain: lambda: SpringMassChain([1.0, 2.0, 1.5], [300.0, 200.0, 100.0], ModalDamping(0.02)),
    LinearStructure: lambda: LinearStructure(MATRICES[0], stiffness=MATRICES[1], damping=ModalDamping(0.02)),
    AffineStructure: lambda: AffineStructure(
        MATRICES[0],
        stiffness=0.5 * MATRICES[1],
        damping=ModalDamping(0.02),
        stiffness_terms=[MATRICES[1]],
        theta=[0.5],
    ),
}


@pytest.mark.parametrize("kind", [k for k in STRUCTURES if k not in CHAINS[1:]])
def test_every_linear_structure_of_the_catalogue(kind):
    """The same structure in every form: modes, damping, matrices, response, and what the base class asks."""
    structure, expected = EXAMPLES[kind](), EXAMPLES[SpringMassChain]()
    assert isinstance(structure, Structure) and structure.family in FAMILIES
    assert structure.n_dof == 3 and not structure.is_symbolic
    assert kind.__name__ in repr(structure)
    modes = structure.modes()
    np.testing.assert_allclose(modes.angular_frequencies, expected.modes().angular_frequencies, rtol=1e-13)
    np.testing.assert_allclose(modes.damping_ratios, 0.02, rtol=1e-13)
    assert modes.effective_modal_masses.sum() == pytest.approx(4.5, rel=1e-13)
    for a, b in zip(structure.matrices(), expected.matrices(), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
    pulse = Record([0.0, 1.0, -2.0, 0.5, 0.0, 0.0], 0.05)
    np.testing.assert_allclose(simulate(structure, pulse), simulate(expected, pulse), atol=1e-12)


@pytest.mark.parametrize("kind", [*CHAINS, *DAMPINGS, HystereticSpecimen])
def test_signatures_show_types_alone(kind):
    """Units and ranges of the arguments stand in `inputs` and in the docstring."""
    assert set(kind.inputs) == set(inspect.signature(kind).parameters)
    assert "Annotated" not in str(inspect.signature(kind))


def test_does_not_share_memory_with_what_was_passed():
    stiffness = np.array([100.0, 100.0])
    chain = SpringMassChain([1.0, 1.0], stiffness, UNDAMPED)
    stiffness[0] = 1.0
    assert chain.stiffness.tolist() == [100.0, 100.0]
    with pytest.raises(ValueError, match="read-only"):
        chain.stiffness[0] = 1.0


def numeric_scaling():
    return SpringMassChain(np.ones(4), [10.0, 20.0, 30.0, 40.0], UNDAMPED)


@pytest.mark.parametrize(
    ("factor", "springs", "expected"),
    [
        (0.5, [0, 2], [5.0, 20.0, 15.0, 40.0]),
        ([2.0, 3.0], [3, 1], [10.0, 60.0, 30.0, 80.0]),
        (np.float32(2.0), 0, [20.0, 20.0, 30.0, 40.0]),
    ],
)
def test_scale_stiffness_numbers_and_variables(factor, springs, expected):
    """Numbers and variables give the same springs, and the chain scaled is left as it was."""
    chain = numeric_scaling()
    np.testing.assert_allclose(chain.scale_stiffness(factor, springs).stiffness, expected, rtol=1e-15)
    assert chain.stiffness.tolist() == [10.0, 20.0, 30.0, 40.0]
    variable = pt.scalar("f") if np.ndim(factor) == 0 else pt.vector("f", shape=(np.size(factor),))
    symbolic = chain.scale_stiffness(variable, springs)
    assert symbolic.is_symbolic
    values = symbolic.stiffness.eval({variable: np.asarray(factor, variable.dtype)}, mode=PLAIN)
    np.testing.assert_allclose(values, expected, rtol=1e-15)


def test_symbolic_damping():
    a = pt.scalar("a")
    for damping, expected in [
        (RayleighDamping(a, 0.002), [0.5, 0.002]),
        (RayleighDamping(0.1, a), [0.1, 0.5]),
    ]:
        chain = SpringMassChain([1.0, 1.0], 100.0, damping)
        assert chain.is_symbolic
        pair = chain.parameters()[2]
        np.testing.assert_allclose(pair.eval({a: 0.5}, mode=PLAIN), expected, rtol=1e-15)
    ratios = SpringMassChain([1.0, 1.0], 100.0, ModalDamping(a)).parameters()[3]
    np.testing.assert_allclose(ratios.eval({a: 0.5}, mode=PLAIN), [0.5, 0.5])


@pytest.mark.parametrize("method", ["matrices", "modes"])
def test_symbolic_structure_has_no_numbers(method):
    chain = numeric_scaling().scale_stiffness(pt.scalar("f"), [0])
    with pytest.raises(TypeError, match="must be asked of a structure of numbers, got PyTensor variables"):
        getattr(chain, method)()


def chain(mass, stiffness, damping=UNDAMPED):
    return SpringMassChain(mass, stiffness, damping)


from_ratios = RayleighDamping.from_ratios
REFUSED_VALUES = {  # what is said: what is given
    "`mass` must be positive and finite, got -2. Pass values in kg": lambda: chain([1, -2.0], 1.0),
    "`stiffness` must be positive and finite, got 0. Pass values in N/m": lambda: chain([1, 1], 0.0),
    "`mass` .* got nan": lambda: chain([1, np.nan], 1.0),
    r"`mass` must be a scalar or a vector, got shape \(1, 2\). Give one value for each": lambda: chain(
        [[1, 1]], 1.0
    ),
    "`mass` must be a scalar or a vector, got a tensor of 2 dimensions": lambda: chain(pt.matrix("m"), [1.0]),
    "must have the same length, got 2 masses and 3 springs": lambda: chain([1, 1], [1, 1, 1]),
    "must have a known length, got none. Pass one of them as an array": lambda: chain(1.0, 1.0),
    "`ratios` must have one value or one for each of the 2 modes, got 3": lambda: chain(
        [1.0, 1.0], 1.0, ModalDamping([0.1] * 3)
    ),
    "`ratios` must be finite and not negative, got -0.1. Pass values in fractions of critical": lambda: (
        ModalDamping(-0.1)
    ),
    "`alpha` must be finite and not negative, got -1. Pass values in 1/s": lambda: RayleighDamping(-1.0, 0.0),
    "`alpha` must be a scalar, got 1 dimension. Pass one value in 1/s": lambda: RayleighDamping(
        [0.1, 0.2], 0.0
    ),
    r"`natural_frequencies` must be two different positive values, got \(1.0, 1.0\)": lambda: from_ratios(
        0.02, (1.0, 1.0)
    ),
    "must allow non-negative coefficients, got alpha = -.* Bring the two ratios closer": lambda: from_ratios(
        (0.02, 0.2), (1.0, 2.0)
    ),
    "must allow non-negative coefficients, got .* beta = -.* or use `ModalDamping`": lambda: from_ratios(
        (0.2, 0.02), (1.0, 2.0)
    ),
}
REFUSED_TYPES = {
    "`mass` must be numbers or PyTensor variables, got str. Pass values in kg": lambda: chain("heavy", [1.0]),
    "`damping` must be a Damping, got float. Pass RayleighDamping": lambda: chain([1.0], 1.0, 0.02),
}


@refusals("build", REFUSED_VALUES, REFUSED_TYPES)
def test_refusals(build, error, match):
    with pytest.raises(error, match=match):
        build()


@pytest.mark.parametrize(
    ("factor", "springs", "error", "match"),
    [
        (1.0, [0.5], TypeError, r"`springs` must be integers, got \[0.5\]"),
        (1.0, [True, False], TypeError, "`springs` must be integers"),
        (1.0, [4], ValueError, r"different numbers from 0 to 3, got \[4\]. Spring 0 is next to the base"),
        (1.0, [1, 1], ValueError, r"different numbers from 0 to 3, got \[1, 1\]"),
        (0.0, [1], ValueError, "`factor` must be positive and finite, got 0"),
        ([1.0, 2.0, 3.0], [0, 1], ValueError, "one for each of the 2 springs, got 3"),
        ("soft", [1], TypeError, "`factor` must be numbers or PyTensor variables, got str"),
    ],
)
def test_scale_stiffness_refusals(factor, springs, error, match):
    with pytest.raises(error, match=match):
        numeric_scaling().scale_stiffness(factor, springs)


def test_stiffness_and_damping_matrices_go_by_name():
    """Both may be matrices: by position one could pass for the other."""
    matrices = SpringMassChain([1.0, 2.0], [100.0, 80.0], RayleighDamping(0.1, 1e-3)).matrices()
    again = LinearStructure(**matrices._asdict()).matrices()
    for a, b in zip(matrices, again, strict=True):
        np.testing.assert_allclose(a, b)
    with pytest.raises(TypeError, match="positional argument"):
        LinearStructure(matrices.mass, matrices.stiffness, matrices.damping)
    with pytest.raises(TypeError, match="positional argument"):
        AffineStructure(matrices.mass, matrices.stiffness, matrices.damping, stiffness_terms=[np.eye(2)])
