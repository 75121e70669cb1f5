"""The kernel of populations against the kernel of one particle, SciPy, and a matrix exponential."""

import numpy as np
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph

from pymc_features import ModalDamping, SpringMassChain, mean_square_discrepancy, paper, response
from pymc_features.ops import PopulationDiscrepancy
from pymc_features.simulators import QUANTITIES, request
from pymc_features.simulators.numbers.vectors import LANES
from pymc_features.simulators.oscillators.march import GROUP
from support.graphs import PLAIN, our_ops
from support.kernels import chain_discrepancy, population_discrepancy
from support.straight import Record

DT = 0.02


@pytest.fixture(scope="module")
def ground():
    return np.random.default_rng(0).normal(size=203)


def both(mass, stiffness, rayleigh, ratios, *common):
    """Results of the population kernel, and of the scalar kernel called for each particle."""
    together = population_discrepancy(mass, stiffness, rayleigh, ratios, *common)
    alone = [
        chain_discrepancy(*(a[p % len(a)] for a in (mass, stiffness, rayleigh, ratios)), *common)
        for p in range(len(together))
    ]
    return together, np.array(alone)


def population(rng, n_particles, n_dof):
    """Random masses, springs and dampings."""
    return (
        rng.uniform(0.5, 2.0, (n_particles, n_dof)),
        1000.0 * rng.uniform(0.3, 3.0, (n_particles, n_dof)),
        rng.uniform(0.0, 1e-3, (n_particles, 2)),
        rng.uniform(0.0, 0.1, (n_particles, n_dof)),
    )


@pytest.mark.parametrize("quantity", range(len(QUANTITIES)), ids=QUANTITIES)
@pytest.mark.parametrize("ratio", [1.0, 0.25, 7.0], ids=lambda r: f"dt x{r:g}")
@pytest.mark.parametrize(("n_dof", "sensors", "n_modes"), [(1, [0], 1), (7, [6, 0, 3], 7), (8, [1, 5], 3)])
def test_agrees_with_the_kernel_of_one_particle(ground, quantity, ratio, n_dof, sensors, n_modes):
    """Odd and even numbers of sensors and modes, more and fewer outputs than samples, broken ends."""
    rng = np.random.default_rng(1)
    asked = request(n_dof, DT, dt=ratio * DT, sensors=sensors, quantity=QUANTITIES[quantity], n_modes=n_modes)
    data = rng.normal(size=(len(sensors), asked.n_outputs(ground.size)))
    common = (ground, DT, asked.substeps, asked.stride, asked.sensors, n_modes, quantity)
    for observed in (data, 0.0 * data):  # zero data: all of the mean square is the response's
        together, alone = both(*population(rng, LANES + 3, n_dof), *common, observed)
        np.testing.assert_allclose(together, alone, rtol=1e-12)


@pytest.mark.parametrize("n_sensors", [1, 3, 8])
def test_more_modes_than_go_together(ground, n_sensors):
    """Modes in two chunks, an odd number of sensors, and a block with a gap."""
    rng, n = np.random.default_rng(6), GROUP + 5
    data = rng.normal(size=(n_sensors, ground.size))
    data[0, 20:25] = np.nan
    common = (ground, DT, 1, 1, rng.permutation(n)[:n_sensors], n, 0, data)
    np.testing.assert_allclose(*both(*population(rng, LANES + 1, n), *common), rtol=1e-10)


@pytest.mark.parametrize(
    ("n_times", "n_particles"), [(1, LANES), (15, 1), (16, LANES - 1), (33, 2 * LANES + 1)]
)
def test_every_length_and_number(ground, n_times, n_particles):
    """The data around the ends of the blocks, and vectors that are not full."""
    rng = np.random.default_rng(2)
    common = (ground[:n_times], DT, 1, 1, np.arange(3), 3, 0, rng.normal(size=(3, n_times)))
    np.testing.assert_allclose(*both(*population(rng, n_particles, 3), *common), rtol=1e-12)


def test_each_invalid_particle_is_nan_on_its_own(ground):
    """Whatever lane it is in; its neighbours keep their digits."""
    rng = np.random.default_rng(5)
    mass, stiffness, rayleigh, ratios = population(rng, 3 * LANES, 4)
    common = (ground, DT, 1, 1, np.arange(4), 4, 0, rng.normal(size=(4, ground.size)))
    valid = population_discrepancy(mass, stiffness, rayleigh, ratios, *common)
    bad = [np.nan, np.inf, -1.0, 0.0, 1e300, 1e-300]
    rows = np.arange(0, 3 * LANES, 2)
    for i, row in enumerate(rows):
        mass[row, i % 4] = bad[i % len(bad)]
    stiffness[rows[::3], 1] = -5.0
    rayleigh[rows[1::5], 0] = np.nan
    together, alone = both(mass, stiffness, rayleigh, ratios, *common)
    np.testing.assert_array_equal(np.isnan(together), np.isnan(alone))
    assert np.isnan(together[rows]).all(axis=1).mean() > 0.6
    np.testing.assert_array_equal(np.delete(together, rows, axis=0), np.delete(valid, rows, axis=0))


def test_parameters_that_particles_share_have_one_row(ground):
    rng = np.random.default_rng(6)
    mass, stiffness, *damping = population(rng, 11, 5)
    common = (ground, DT, 1, 1, np.arange(5), 5, 0, rng.normal(size=(5, ground.size)))
    rows = mass[:1], stiffness, *(a[:1] for a in damping)
    spread = [np.repeat(a, 11 // len(a), 0) for a in rows]
    np.testing.assert_array_equal(
        population_discrepancy(*rows, *common), population_discrepancy(*spread, *common)
    )
    with pytest.raises(ValueError, match="must have one row, or one for each particle"):
        population_discrepancy(mass[:3], *rows[1:], *common)


def test_repeated_close_and_far_frequencies(ground):
    """Two halves that hardly touch, in lockstep with ordinary chains; soft springs and light masses."""
    rng = np.random.default_rng(7)
    mass, stiffness, *damping = population(rng, LANES, 6)
    for lane, link in enumerate([1e-12, 1e-9, 1e-6, 1.0]):
        mass[lane], stiffness[lane] = 1.0, 1000.0
        stiffness[lane, 3] = link
    common = (ground, DT, 1, 1, np.arange(6), 6, 0, rng.normal(size=(6, ground.size)))
    np.testing.assert_allclose(*both(mass, stiffness, *damping, *common), rtol=1e-11)
    mass, stiffness, *damping = population(rng, LANES + 2, 40)
    stiffness[::2, :3] *= 1e-3
    mass[1::3, 30:] *= 1e-4
    common = (ground, DT, 1, 1, np.array([0, 20, 39]), 40, 3, np.zeros((3, ground.size)))
    np.testing.assert_allclose(*both(mass, stiffness, *damping, *common), rtol=1e-9)


def test_batches_of_batches():
    """Of the ten-storey example: as one by one."""
    record = Record(np.random.default_rng(8).normal(size=120), DT)
    data, theta, thetas = np.random.default_rng(9).normal(size=(10, 120)), pt.scalar(), pt.matrix()
    mu, values = response(paper.chain(theta), record), np.linspace(0.6, 1.4, 6).reshape(2, 3)
    common = record.acceleration, DT, 1, 1, np.arange(10), 10, 0, data
    expected = [[chain_discrepancy(*paper.chain(v).parameters(), *common) for v in row] for row in values]
    batch = vectorize_graph(mean_square_discrepancy(mu, data), {theta: thetas})
    of_batch = mean_square_discrepancy(vectorize_graph(mu, {theta: thetas}), data)
    assert PopulationDiscrepancy in our_ops([of_batch])
    for e in (batch, of_batch):
        np.testing.assert_allclose(e.eval({thetas: values}, mode=PLAIN), expected, rtol=1e-12)


def test_wrong_dimensions_are_refused():
    chain = SpringMassChain(np.ones(2), 100.0, ModalDamping(0.02))
    inputs = response(chain, Record([0.0, 1.0], DT)).owner.inputs
    with pytest.raises(ValueError, match=r"`mass` must be \(particle, n\), got 1 dimensions"):
        PopulationDiscrepancy()(*inputs, np.zeros((2, 2)))
    rows = [x[None] for x in inputs[:4]]
    with pytest.raises(ValueError, match=r"`observed` must be \(sensor, time\), got 1 dimensions"):
        PopulationDiscrepancy()(*rows, *inputs[4:], np.zeros(2))
