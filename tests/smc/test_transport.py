"""Maps fitted to gradients: inverses and Jacobians, posteriors that they follow, and what refuses them."""

import numpy as np

from pymc_features.smc.proposals.reference import Mode, Reference
from pymc_features.smc.proposals.transport import Bend, Stretch, Transport, pairs

D = 6


def some_map():
    """Two bends, each between stretches, of size one."""
    rng = np.random.default_rng(3)
    before = pairs(4)[1] < np.arange(D)[:, None]
    steps = []
    for _ in range(2):
        steps.append(Stretch(rng.normal(size=D), np.eye(D) + 0.2 * rng.normal(size=(D, D))))
        steps.append(Bend(np.where(before, 0.3 * rng.normal(size=before.shape), 0.0)))
    return Transport(tuple(steps))


def jacobians(function, z):
    """Of a map at points (n, d), by central differences: (n, d, d)."""
    h = 1e-6
    return np.stack([(function(z + h * e) - function(z - h * e)) / (2.0 * h) for e in np.eye(D)], axis=2)


def test_inverse_volume_and_slopes():
    transport, z = some_map(), np.random.default_rng(4).normal(size=(50, D))
    x = transport.inverse(z)
    back, log_jacobian = transport.forward(x)
    np.testing.assert_allclose(back, z, atol=1e-10)
    slopes = np.random.default_rng(5).normal(size=(50, D))
    by_differences = jacobians(transport.inverse, z)
    np.testing.assert_allclose(-np.linalg.slogdet(by_differences)[1], log_jacobian, atol=1e-6)
    pulled = np.einsum("ni,nij->nj", slopes, by_differences)
    np.testing.assert_allclose(transport.pull(slopes, z), pulled, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(transport.push(transport.pull(slopes, z), z), slopes, atol=1e-9)


class Bananas:
    """Pairs (a, b) of a normal a and b = a^2 / 4 + noise, like two springs between neighbouring sensors."""

    def __init__(self, n_pairs, noise=0.3):
        self.n, self.noise = n_pairs, noise

    def values(self, x):
        return self.gradient(x)[0]

    def gradient(self, x):
        a, b = x[:, : self.n], x[:, self.n :]
        rest = (b - 0.25 * a**2) / self.noise
        value = -0.5 * (a**2 + rest**2).sum(axis=1) - x.shape[1] / 2 * np.log(2.0 * np.pi)
        slope = np.hstack([-a + 0.5 * a * rest / self.noise, -rest / self.noise])
        return value - self.n * np.log(self.noise), slope

    def reference(self) -> Reference:
        """Laplace's approximation at the mode 0."""
        factor = np.diag(np.repeat([1.0, self.noise], self.n))
        d = 2 * self.n
        return Reference([Mode(np.zeros(d), factor, 0.0, 1)], np.zeros(d), np.ones(d))


def efficiency(reference, target, n=4000):
    """Effective share of draws from what stands at the modes, and the evidence from them."""
    x = reference.mixture.draw(n, np.random.default_rng(6))
    log_weights = target.values(x) - reference.mixture.log_density(x)
    w = np.exp(log_weights - log_weights.max())
    return w.sum() ** 2 / (w @ w) / n, np.log(w.mean()) + log_weights.max()


def test_bananas_become_straight():
    """Laplace's approximation keeps a hundredth of 4,000 draws, the map a third; evidence within 0.1."""
    target = Bananas(10)
    laplace = target.reference()
    bent = laplace.bent(target.values, target.gradient, np.random.default_rng(7))
    before, _ = efficiency(laplace, target)
    after, evidence = efficiency(bent, target)
    assert before < 0.02 and after > 0.3, (before, after)
    assert abs(evidence) < 0.1


def test_slopes_of_the_reference():
    """Its gradient, which trajectories from it follow, against differences."""
    target, d = Bananas(8), 16
    reference = target.reference().bent(target.values, target.gradient, np.random.default_rng(7))
    assert reference.maps[0] is not None
    x = 0.3 * np.random.default_rng(8).normal(size=(20, d)) * np.repeat([1.0, target.noise], 8)

    def density(x):
        return reference.log_density(x, -0.5 * (x**2).sum(axis=1))

    h = 1e-6
    expected = np.stack([(density(x + h * e) - density(x - h * e)) / (2.0 * h) for e in np.eye(d)], axis=1)
    found = reference.gradient(x, -0.5 * (x**2).sum(axis=1), -x)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
