"""Populations of large sparse structures: modes from those of the structures before, checked."""

import numpy as np
import pytest
from scipy import sparse

from pymc_features import AffineStructure, ModalDamping
from pymc_features.modal_features.quantities import AT_REST
from pymc_features.simulators import Outputs
from pymc_features.simulators.linear.arguments import LinearParameters
from pymc_features.simulators.modal import linear
from pymc_features.simulators.modal.neighbours import LARGE, Neighbours
from pymc_features.simulators.modal.perturbation import Cotangent

SIDES = 76, 40  # of a membrane on springs
APPENDAGE = 100  # a degree of freedom that hangs on one spring


@pytest.fixture(scope="module")
def membrane():
    """n = 3040: theta scale the springs of both directions, the bedding, and one spring of an appendage."""
    n = SIDES[0] * SIDES[1]
    assert n >= LARGE

    def chain(k):
        return sparse.diags_array([np.full(k, 2.0), -np.ones(k - 1), -np.ones(k - 1)], offsets=[0, 1, -1])

    def identity(k):
        return sparse.eye_array(k)

    keep = np.ones(n)
    keep[APPENDAGE] = 0.0
    keep = sparse.diags_array(keep)
    terms = [
        keep @ (1e4 * sparse.kron(chain(SIDES[0]), identity(SIDES[1]))) @ keep,
        keep @ (2.3e4 * sparse.kron(identity(SIDES[0]), chain(SIDES[1]))) @ keep,
        50.0 * sparse.diags_array(np.linspace(0.0, 1.0, n)) @ keep,
        2e4 * (sparse.eye_array(n) - keep),
    ]
    terms = [term.tocsc() for term in terms]
    return AffineStructure(
        sparse.eye_array(n).tocsc(),
        stiffness=sum(terms[1:], terms[0]),
        damping=ModalDamping(0.01),
        stiffness_terms=terms,
        theta=np.zeros(4),
    )


def population(structure, thetas):
    _, rayleigh, ratios = structure.parameters()
    return LinearParameters(thetas, rayleigh[None], ratios[None], *structure.constants(AT_REST))


@pytest.fixture
def made(monkeypatch):
    """The `Neighbours` that are made meanwhile."""
    found = []
    new = Neighbours.__init__

    def keep(self, *args):
        new(self, *args)
        found.append(self)

    monkeypatch.setattr(Neighbours, "__init__", keep)
    return found


def one_by_one(parameters, wanted):
    rows = [parameters._replace(theta=theta[None]) for theta in parameters.theta]
    return [
        np.concatenate(x)
        for x in zip(*(linear.linear_population_modes(a, wanted) for a in rows), strict=True)
    ]


M = 4
WANTED = Outputs(np.array([5, 777, 2000]), M, 0)
NEAR = 0.05 * np.random.default_rng(3).standard_normal((12, 4))


def test_modes_are_those_of_each_by_itself(membrane, made):
    """Frequencies to rounding, shapes to 1e-6; most of them without beginning anew."""
    thetas = NEAR.copy()
    thetas[7, 0] = -3.0  # no structure
    parameters = population(membrane, thetas)
    frequencies, shapes, ratios = linear.linear_population_modes(parameters, WANTED)
    assert len(made) == 1 and made[0].solved <= 4
    assert made[0].basis.shape[1] > made[0].solved * made[0].q  # it learns from those it improved, too
    expected = one_by_one(parameters, WANTED)
    assert len(made) == 1
    np.testing.assert_allclose(frequencies, expected[0], rtol=1e-12)
    sign = np.where((shapes * expected[1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    np.testing.assert_allclose(sign * shapes, expected[1], rtol=0, atol=1e-6 * np.nanmax(abs(shapes)))
    np.testing.assert_allclose(ratios, expected[2], rtol=1e-12)
    assert np.isnan(frequencies[7]).all() and np.isnan(frequencies).sum() == M


@pytest.mark.parametrize("softer", [-0.9999, -1.01], ids=["a mode that no other has", "no structure"])
def test_what_the_neighbours_do_not_know_is_found(membrane, made, softer):
    """A spring so soft that its mass is the lowest mode, or gone: the inertia tells, not the residuals."""
    thetas = NEAR[:6].copy()
    thetas[4, 3] = softer
    parameters = population(membrane, thetas)
    frequencies, *_ = linear.linear_population_modes(parameters, WANTED)
    np.testing.assert_allclose(frequencies, one_by_one(parameters, WANTED)[0], rtol=1e-12)
    assert (np.isnan(frequencies[4]).all()) == (softer < -1.0)
    if softer > -1.0:
        assert frequencies[4, 0] == pytest.approx(np.sqrt(2e4 * (1.0 + softer)) / (2.0 * np.pi))


def test_gradients_are_those_of_each_by_itself(membrane, made):
    parameters, rng = population(membrane, NEAR[:5]), np.random.default_rng(1)
    _, shapes, _ = linear.linear_population_modes(parameters, WANTED)
    weights = rng.normal(size=(5, M)), np.zeros((5, M, 3)), rng.normal(size=(5, M))
    weights[1][:] = shapes  # of phi' phi / 2: without a sign
    gradients = linear.linear_modes_gradient(parameters, WANTED, Cotangent(*weights))
    assert all(near.solved < 4 for near in made)
    for p, theta in enumerate(parameters.theta):
        own = parameters._replace(theta=theta[None])
        alone = linear.linear_modes_gradient(own, WANTED, Cotangent(*(w[p : p + 1] for w in weights)))
        np.testing.assert_allclose(gradients[0][p], alone[0][0], rtol=0, atol=1e-6 * abs(alone[0]).max())
