"""Chains of soft and nearly rigid parts, against sixty digits."""

import mpmath
import numpy as np
import pymc as pm
import pytest

import pymc_features as pmf

DAMPING = pmf.ModalDamping(0.02)
CHAINS = {
    "rigid storey": ([1.0] * 3, [1e2, 1e18, 1e2]),
    "rigid foundation": ([2e5] * 3, [1e23, 1e8, 2e8]),
    "weak link": ([1.0, 2.0, 3.0, 1.0], [1e4, 1e-14, 3e4, 2e4]),
    "light masses": ([1.0, 1e-20, 1.0, 1e-9], [300.0, 200.0, 500.0, 100.0]),
    "every order": ([3.0, 1e-6, 1e6, 2.0, 1e3, 1e-3], [1e-12, 1e6, 2.0, 1e15, 1e-3, 1e9]),
}


def exact(mass, stiffness):
    """omega (n,) and mass-normalised shapes (n, n), columns, positive at the top."""
    with mpmath.workdps(80):
        n = len(mass)
        root = [mpmath.sqrt(mpmath.mpf(m)) for m in mass]
        a = mpmath.zeros(n)
        for i, k in enumerate(map(mpmath.mpf, stiffness)):
            a[i, i] += k / root[i] ** 2
            if i:
                a[i - 1, i - 1] += k / root[i - 1] ** 2
                a[i, i - 1] = a[i - 1, i] = -k / (root[i] * root[i - 1])
        values, vectors = mpmath.eigsy(a)
        shapes = np.array([[float(vectors[i, r] / root[i]) for r in range(n)] for i in range(n)])
        return np.array([float(mpmath.sqrt(v)) for v in values]), shapes * np.sign(shapes[-1])


@pytest.mark.parametrize("name", CHAINS)
def test_frequencies_and_shapes_are_right_to_their_own_digits(name):
    mass, stiffness = map(np.array, CHAINS[name])
    omega, shapes = exact(mass, stiffness)
    found = pmf.SpringMassChain(mass, stiffness, DAMPING).modes()
    np.testing.assert_allclose(found.angular_frequencies, omega, rtol=1e-13)
    if name in ("rigid foundation", "every order"):
        with pm.Model():
            factor = pm.Flat("factor")
            frequencies = pmf.modes(pmf.SpringMassChain(mass, factor * stiffness, DAMPING))[0]
        inside = 2.0 * np.pi * frequencies.eval({factor: 1.0}, mode="FAST_COMPILE")
        np.testing.assert_allclose(inside, omega, rtol=1e-13)
    cosines = (found.mode_shapes * mass[:, None] * shapes).sum(axis=0)
    np.testing.assert_allclose(abs(cosines), 1.0, rtol=1e-12)
    np.testing.assert_allclose(found.mode_shapes[:, 0], shapes[:, 0], rtol=1e-10)
    gram = (found.mode_shapes * mass[:, None]).T @ found.mode_shapes
    np.testing.assert_allclose(gram, np.eye(len(mass)), atol=1e-10)


@pytest.mark.slow
def test_uniform_chains_of_any_length_join_both_routes():
    """Closed form; the lowest modes of two thousand storeys lie below the border, the others above."""
    n = 2000
    found = pmf.SpringMassChain(np.ones(n), np.ones(n), DAMPING).modes()
    r = np.arange(1, n + 1)
    closed = 2.0 * np.sin((2 * r - 1) * np.pi / (4 * n + 2))
    np.testing.assert_allclose(found.angular_frequencies, closed, rtol=1e-11)
    gram = found.mode_shapes[:, :8].T @ found.mode_shapes[:, :8]
    np.testing.assert_allclose(gram, np.eye(8), atol=1e-10)


@pytest.mark.parametrize(("ratio", "warned"), [(1e9, False), (1e14, True), (1e18, True)])
def test_matrices_that_cannot_hold_soft_springs_are_named(ratio, warned, recwarn):
    chain = pmf.SpringMassChain(np.ones(3), [1e2, 1e2 * ratio, 1e2], DAMPING)
    pmf.LinearStructure(**chain.matrices()._asdict()).modes()
    said = [str(w.message) for w in recwarn]
    assert len(said) == warned
    if warned:
        assert "are lost to rounding beside the stiffness at degree of freedom" in said[0]
        assert "or declare a chain as SpringMassChain" in said[0]
    free = pmf.LinearStructure(np.ones(2), stiffness=[[1.0, -1.0], [-1.0, 1.0]], damping=DAMPING)
    assert free.modes().angular_frequencies[0] == 0.0 and len(recwarn) == warned  # of one scale
