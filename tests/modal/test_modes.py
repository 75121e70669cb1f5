"""modes(): values, gradients also where frequencies nearly meet, populations, refusals."""

import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph
from scipy import sparse

import pymc_features as pmf
from pymc_features.modal.structural_modes import ModesGradient, StructuralModes
from support.families import CASES, TRUTH
from support.graphs import PLAIN, REWRITTEN
from support.precise import precise_gradient

WEIGHTS = np.random.default_rng(5)


def all_of(found):
    """Frequencies, shapes and ratios in one vector."""
    return pt.concatenate([found.frequencies, found.shapes.ravel(), found.damping_ratios])


def aligned(shapes, near):
    """Rows with the sense of others."""
    return shapes * np.where((shapes * near).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)


@pytest.mark.parametrize("name", CASES)
def test_modes_are_those_of_the_structure_and_a_population_is_one_call(name):
    """Values and gradients of a population as one by one; what is no structure is alone."""
    build, _ = CASES[name]
    x, rows = pt.vector("x", shape=(2,)), pt.matrix("rows", shape=(None, 2))
    found = pmf.modes(build(x), 2, sensors=[2, 0])
    assert [v.type.shape for v in found] == [(2,), (2, 2), (2,)]
    total = all_of(found)
    weighed = pt.sum(total * np.linspace(0.5, 1.5, 8))
    batch = vectorize_graph([total, weighed], {x: rows})
    function = pytensor.function([rows], [batch[0], pt.grad(batch[1].sum(), rows)], mode=REWRITTEN)
    ops = [n.op for n in function.maker.fgraph.apply_nodes]
    ours = [op for op in ops if isinstance(op, StructuralModes | ModesGradient)]
    assert ours and all(op.batched for op in ours)
    one = pytensor.function([x], [total, pt.grad(weighed, x)], mode=PLAIN)
    points = np.random.default_rng(1).uniform(0.7, 1.3, (5, 2))
    points[2, 0] = -3.0
    values, slopes = function(points)
    for i, point in enumerate(points):
        a, b = one(point)
        np.testing.assert_allclose(values[i], a, rtol=1e-13)
        np.testing.assert_allclose(slopes[i], b, rtol=1e-11, atol=1e-12)
        if i != 2:
            expected = build(point).modes()
            near = expected.mode_shapes[[2, 0], :2].T
            np.testing.assert_allclose(a[:2], expected.natural_frequencies[:2], rtol=1e-13)
            np.testing.assert_allclose(aligned(a[2:6].reshape(2, 2), near), near, rtol=0, atol=1e-12)
            np.testing.assert_allclose(a[6:], expected.damping_ratios[:2], rtol=1e-11)
    assert np.isnan(values[2]).all() and np.isfinite(np.delete(values, 2, axis=0)).all()


def test_frequencies_of_a_uniform_chain_are_in_closed_form():
    n, k = 7, pt.scalar("k")
    found = pmf.modes(pmf.SpringMassChain(np.full(n, 2.0), k, pmf.ModalDamping(0.01)))
    j = np.arange(1, n + 1)
    omega = 2.0 * np.sqrt(300.0 / 2.0) * np.sin((2 * j - 1) * np.pi / (2 * (2 * n + 1)))
    np.testing.assert_allclose(found.frequencies.eval({k: 300.0}), omega / (2 * np.pi), rtol=1e-14)
    np.testing.assert_allclose(found.damping_ratios.eval({k: 300.0}), 0.01, rtol=1e-14)


def test_a_nonlinear_chain_has_the_modes_of_small_motions():
    stiffness = pt.vector("stiffness", shape=(3,))
    cubic = pt.vector("cubic", shape=(3,))
    linear = pmf.modes(pmf.SpringMassChain(np.ones(3), stiffness, pmf.RayleighDamping(0.1, 1e-3)))
    duffing = pmf.modes(pmf.DuffingChain(np.ones(3), stiffness, pmf.RayleighDamping(0.1, 1e-3), cubic))
    point = {stiffness: [100.0, 80.0, 60.0], cubic: [1e4, 2e4, 3e4]}
    for a, b in zip(linear, duffing, strict=True):
        np.testing.assert_array_equal(b.eval(point), a.eval({stiffness: point[stiffness]}))
    slope = pt.grad(duffing.frequencies.sum(), cubic)
    np.testing.assert_array_equal(slope.eval(point), 0.0)


def test_a_rigid_body_has_frequency_zero_and_no_infinite_gradient():
    theta = pt.vector("theta", shape=(1,))
    spring = 100.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    free = pmf.AffineStructure(
        [1.0, 2.0],
        stiffness=np.zeros((2, 2)) + spring,
        damping=pmf.ModalDamping(0.0),
        stiffness_terms=[spring],
        theta=theta,
    )
    found = pmf.modes(free)
    frequencies, ratios = (v.eval({theta: [0.0]}) for v in (found.frequencies, found.damping_ratios))
    np.testing.assert_allclose(frequencies, [0.0, np.sqrt(150.0) / (2 * np.pi)], atol=1e-14)
    np.testing.assert_array_equal(ratios, 0.0)
    slope = pt.grad(found.frequencies[1], theta).eval({theta: [0.0]})
    np.testing.assert_allclose(slope, 0.5 * frequencies[1], rtol=1e-13)


def test_gradients_of_a_chain_against_sixty_digits():
    """By masses, springs and Rayleigh's pair; with all modes and with some."""
    check_chain([1.0, 1.5, 0.7, 1.2], [100.0, 150.0, 80.0, 120.0], tolerance=1e-12)


def test_gradients_of_a_chain_whose_frequencies_differ_by_a_millionth():
    """A tuned mass damper of 1e-12 of the mass: two frequencies at 1e-6 of each other."""
    x = np.array([1.0, 1e-12]), np.array([100.0, 1e-10])
    frequencies = pmf.SpringMassChain(*x, pmf.ModalDamping(0.0)).modes().natural_frequencies
    assert 0.5e-6 < np.diff(frequencies)[0] / frequencies[0] < 2e-6
    check_chain(*x, tolerance=1e-8, relative_to_each=True)


def check_chain(mass, stiffness, tolerance, relative_to_each=False):
    n = len(mass)
    drifts = np.diff(np.eye(n, dtype=int), axis=0, prepend=0)
    rayleigh = 0.3, 2e-3

    def matrices(theta):
        m, k, (alpha, beta) = theta[:n], theta[n : 2 * n], theta[2 * n :]
        matrix_m = np.diag(m)
        matrix_k = sum(k[i] * np.outer(d, d) for i, d in enumerate(drifts))
        return matrix_m, alpha * matrix_m + beta * matrix_k, matrix_k

    x = pt.vector("x", shape=(2 * n + 2,))
    chain = pmf.SpringMassChain(x[:n], x[n : 2 * n], pmf.RayleighDamping(x[-2], x[-1]))
    at = np.array([*mass, *stiffness, *rayleigh])
    for m in {n, n - 1}:
        found = pmf.modes(chain, m)
        near = found.shapes.eval({x: at})
        weights = WEIGHTS.normal(size=m), WEIGHTS.normal(size=(m, n)), WEIGHTS.normal(size=m)
        total = sum(pt.sum(w * v) for w, v in zip(weights, found, strict=True))
        slope = pt.grad(total, x).eval({x: at})
        expected = precise_gradient(matrices, at, weights, near)
        scale = abs(expected) if relative_to_each else abs(expected).max()
        assert (abs(slope - expected) <= tolerance * scale).all(), (slope, expected)


def two_directions(kind, damping, theta, n=2, gap=1e-6):
    """Two columns of n storeys in x and y, alike up to a small difference and a small coupling.

    theta: a stiffness of x, of y, a coupling of the two, and a mass at the top of x.
    """
    storeys = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    storeys[-1, -1] = 1.0
    storeys *= 100.0
    zero = np.zeros((n, n))
    top = np.zeros((2 * n, 2 * n))
    top[n - 1, n - 1] = 1.0
    both = np.block([[storeys, zero], [zero, storeys * (1.0 + gap)]])
    terms = [
        np.block([[storeys, zero], [zero, zero]]),
        np.diag([0.0] * (n + 1) + [90.0] + [0.0] * (n - 2)),
        np.block([[zero, 100.0 * np.eye(n)], [100.0 * np.eye(n), zero]]),
    ]
    mass = np.eye(2 * n) + 0.2 * np.eye(2 * n, k=1) + 0.2 * np.eye(2 * n, k=-1)
    mass[n - 1, n] = mass[n, n - 1] = 0.0
    return pmf.AffineStructure(
        kind(mass),
        stiffness=kind(both),
        damping=damping,
        stiffness_terms=[*map(kind, terms), None],
        mass_terms=[None, None, None, kind(top)],
        theta=theta,
    )


DAMPERS = np.diag([0.5, 0.3, 0.8, 0.2]) + np.diag([0.1] * 3, 1)
AFFINE = {
    "dense": (np.asarray, pmf.RayleighDamping(0.3, 2e-3), 2),
    "sparse": (sparse.csc_array, pmf.RayleighDamping(0.3, 2e-3), 6),
    "damping matrix": (np.asarray, DAMPERS, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gap"), [*((name, 1e-6) for name in AFFINE), ("dense", 0.3)])
def test_gradients_of_matrices_against_sixty_digits(name, gap):
    """1e-8, where two frequencies differ by 1e-6 of them, too."""
    kind, damping, n = AFFINE[name]
    theta, at = pt.vector("theta", shape=(4,)), np.array([0.0, 0.0, 1e-2 * gap, 0.0])
    m = 3 if n == 2 else 4
    structure = two_directions(kind, damping, theta, n, gap)
    found = pmf.modes(structure, m)
    frequencies = found.frequencies.eval({theta: at})
    assert np.diff(frequencies)[0] / frequencies[0] == pytest.approx(0.5 * gap, rel=0.3)
    stacks = [a.stack.reshape(len(a.stack), -1) for a in dense_terms(structure)]

    def matrices(x):
        mass, given, stiffness = (
            sum((stack[1 + i] * x[i] for i in range(len(stack) - 1)), stack[0] * (x[0] ** 0)).reshape(
                2 * n, -1
            )
            for stack in stacks
        )
        if isinstance(damping, pmf.RayleighDamping):
            given = damping.alpha * mass + damping.beta * stiffness
        return mass, given, stiffness

    near = found.shapes.eval({theta: at})
    weights = WEIGHTS.normal(size=m), WEIGHTS.normal(size=(m, 2 * n)), WEIGHTS.normal(size=m)
    total = sum(pt.sum(w * v) for w, v in zip(weights, found, strict=True))
    slope = pt.grad(total, theta).eval({theta: at})
    expected = precise_gradient(matrices, at, weights, near)
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-8 * abs(expected).max())


def dense_terms(structure):
    """M, C and K of a structure as affine sums of full matrices."""
    full = []
    for a in structure._terms:
        if a is None:
            a = structure._terms[0]
        dense = [m.toarray() if sparse.issparse(m) else m for m in a.matrices()]
        full.append(type("Full", (), {"stack": np.array(dense)}))
    return full


def test_what_depends_on_the_plane_of_equal_frequencies_has_a_gradient():
    """Two uncoupled directions that are the same: sums over the pair, against differences."""
    theta = pt.vector("theta", shape=(4,))
    found = pmf.modes(two_directions(np.asarray, pmf.ModalDamping(0.01), theta, gap=0.0), 2)
    direction = np.array([0.3, -1.0, 0.5, 0.7])
    total = found.frequencies.sum() + pt.sum(pt.sqr(pt.dot(found.shapes, direction)))
    function = pytensor.function([theta], [total, pt.grad(total, theta)], mode=PLAIN)
    value, slope = function(np.zeros(4))
    assert np.isfinite(slope).all()
    for i, unit in enumerate(np.eye(4)):
        h = 1e-3
        d = [(function(s * h * unit)[0] - function(-s * h * unit)[0]) / (2 * s * h) for s in (1.0, 0.5, 0.25)]
        first, second = (4 * d[1] - d[0]) / 3, (4 * d[2] - d[1]) / 3
        assert slope[i] == pytest.approx((16 * second - first) / 15, rel=1e-7, abs=1e-9)


def test_no_second_derivative_is_said():
    k = pt.scalar("k")
    found = pmf.modes(pmf.SpringMassChain([1.0, 1.0], k, pmf.ModalDamping(0.01)))
    with pytest.raises(Exception, match="first derivatives only"):
        pt.grad(pt.grad(found.frequencies.sum(), k), k)


@pytest.mark.slow
def test_numba_runs_the_same():
    build, _ = CASES["sparse"]
    x = pt.vector("x", shape=(2,))
    total = pt.sum(all_of(pmf.modes(build(x), 2)))
    outputs = [total, pt.grad(total, x)]
    compiled, plain = (pytensor.function([x], outputs, mode=mode) for mode in ("NUMBA", PLAIN))
    for a, b in zip(compiled(TRUTH * 1.1), plain(TRUTH * 1.1), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_refusals():
    chain = pmf.SpringMassChain(np.ones(3), 100.0, pmf.ModalDamping(0.01))
    with pytest.raises(TypeError, match="`structure` must be a Structure, got str"):
        pmf.modes("chain")
    with pytest.raises(ValueError, match="`n_modes` must be an integer from 1 to 3, got 4"):
        pmf.modes(chain, 4)
    with pytest.raises(ValueError, match="`sensors` must lie between 0 and 2"):
        pmf.modes(chain, sensors=[3])
    with pytest.raises(ValueError, match="`sensors` must be left out with `outputs`"):
        pmf.modes(chain, sensors=[0], outputs=np.eye(3))
    with pytest.raises(ValueError, match=r"`outputs` must have shape \(s, 3\)"):
        pmf.modes(chain, outputs=np.eye(2))
    few = pmf.LinearStructure(np.ones(3), stiffness=np.eye(3), damping=pmf.ModalDamping([0.01, 0.02]))
    with pytest.raises(ValueError, match="`n_modes` must not exceed the 2 damping ratios"):
        pmf.modes(few)
    assert pmf.modes(few, 2).frequencies.type.shape == (2,)
