"""The kernel of populations against the kernel of one particle, SciPy, and a matrix exponential."""

import numpy as np
import pytensor.tensor as pt
import pytest
from pytensor.graph.replace import vectorize_graph

from pymc_features import ModalDamping, SpringMassChain, mean_square_discrepancy, paper, response
from pymc_features.ops import PopulationDiscrepancy
from pymc_features.simulators import FAMILIES, QUANTITIES, request
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from pymc_features.simulators.oscillators.march import GROUP
from support.graphs import PLAIN, our_ops
from support.kernels import chain_discrepancy, population_discrepancy
from support.reference import first_order_hold
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
@pytest.mark.parametrize("ratio", [1.0, 0.25, 3.0, 7.0], ids=lambda r: f"dt x{r:g}")
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


@pytest.mark.parametrize("n_sensors", range(1, 9))
def test_more_modes_than_go_together(ground, n_sensors):
    """Modes in two chunks, an odd number of sensors, and a block with a gap."""
    rng, n = np.random.default_rng(6), GROUP + 5
    data = rng.normal(size=(n_sensors, ground.size))
    data[0, 20:25] = np.nan
    common = (ground, DT, 1, 1, rng.permutation(n)[:n_sensors], n, 0, data)
    np.testing.assert_allclose(*both(*population(rng, LANES + 1, n), *common), rtol=1e-10)


@pytest.mark.parametrize("n_times", [1, 2, 15, 16, 17, 32, 33])
@pytest.mark.parametrize("n_particles", [1, LANES - 1, LANES, 2 * LANES + 1])
def test_every_length_and_number(ground, n_times, n_particles):
    """The data around the ends of the blocks, and vectors that are not full."""
    rng = np.random.default_rng(2)
    common = (ground[:n_times], DT, 1, 1, np.arange(3), 3, 0, rng.normal(size=(3, n_times)))
    np.testing.assert_allclose(*both(*population(rng, n_particles, 3), *common), rtol=1e-12)


def views(data):
    """The same data as part of the rows, or columns, of a larger array, and as a field of records."""
    n_sensors, n_times = data.shape
    larger = np.full((n_times + 3, n_times + 3), np.nan)
    records = np.zeros(n_sensors, dtype=[("is_valid", "u1"), ("samples", "f8", (n_times,))])
    for view in (larger[:n_sensors, 1:-2], larger.T[:n_sensors, 1:-2], records["samples"]):
        view[:] = data
        yield view


def test_data_that_are_views(ground):
    """Compiled code reaches data by address: it takes the samples, not what stands between them."""
    rng, chain = np.random.default_rng(7), FAMILIES["chain"]
    structures, data = population(rng, 2, 3), rng.normal(size=(3, ground.size))
    given = chain.assemble([*structures, ground, DT, 1, 1, NO_DIRECT, np.arange(3), 3], 0)
    kernel = chain.kernels["population_discrepancy"]
    for view in views(data):
        np.testing.assert_allclose(kernel(*given, view), kernel(*given, data), rtol=1e-12)


def test_matrix_exponential():
    """One storey against its state-space solution with the exponential of a linear excitation."""
    omega, zeta, h = 9.0, 0.07, 0.05
    ground = np.random.default_rng(3).normal(size=60)
    drag, spring, load = np.array([[[2 * zeta * omega]], [[omega**2]], [[-1.0]]])
    u, v, _ = first_order_hold(drag, spring, load, ground[None], h)
    absolute = -(drag @ v + spring @ u)
    data = np.random.default_rng(4).normal(size=(1, 60))
    one = np.ones((1, 1))
    common = (ground, h, 1, 1, np.arange(1), 1, 0, data)
    e = population_discrepancy(one, omega**2 * one, np.zeros((1, 2)), zeta * one, *common)
    np.testing.assert_allclose(e, [[np.mean((data - absolute) ** 2)]], rtol=1e-12)


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
    mass, stiffness, rayleigh, ratios = population(rng, 11, 5)
    common = (ground, DT, 1, 1, np.arange(5), 5, 0, rng.normal(size=(5, ground.size)))
    shared = population_discrepancy(mass[:1], stiffness, rayleigh[:1], ratios[:1], *common)
    spread = population_discrepancy(
        *(
            np.repeat(mass[:1], 11, 0),
            stiffness,
            np.repeat(rayleigh[:1], 11, 0),
            np.repeat(ratios[:1], 11, 0),
        ),
        *common,
    )
    np.testing.assert_array_equal(shared, spread)
    with pytest.raises(ValueError, match="must have one row, or one for each particle"):
        population_discrepancy(mass[:3], stiffness, rayleigh, ratios, *common)


def test_repeated_and_close_frequencies(ground):
    """Two halves that hardly touch: pairs of equal frequencies, in lockstep with ordinary chains."""
    rng = np.random.default_rng(7)
    mass, stiffness, rayleigh, ratios = population(rng, LANES, 6)
    for lane, link in enumerate([1e-12, 1e-9, 1e-6, 1.0]):
        mass[lane] = 1.0
        stiffness[lane] = 1000.0
        stiffness[lane, 3] = link
    common = (ground, DT, 1, 1, np.arange(6), 6, 0, rng.normal(size=(6, ground.size)))
    np.testing.assert_allclose(*both(mass, stiffness, rayleigh, ratios, *common), rtol=1e-11)


@pytest.fixture(scope="module")
def case():
    """Discrepancy of the ten-storey example as a function of theta, and its value at numbers."""
    record = Record(np.random.default_rng(8).normal(size=120), DT)
    data = np.random.default_rng(9).normal(size=(10, 120))
    theta = pt.scalar("theta")
    e = mean_square_discrepancy(response(paper.chain(theta), record), data)

    def exact(value):
        chain = paper.chain(value).parameters()
        return chain_discrepancy(*chain, record.acceleration, DT, 1, 1, np.arange(10), 10, 0, data)

    return theta, e, exact, record, data


def test_batches_of_batches(case):
    theta, e, exact, record, data = case
    thetas = pt.matrix("thetas")
    values = np.linspace(0.6, 1.4, 6).reshape(2, 3)
    expected = np.array([[exact(v) for v in row] for row in values])
    batch = vectorize_graph(e, {theta: thetas})
    np.testing.assert_allclose(batch.eval({thetas: values}, mode=PLAIN), expected, rtol=1e-12)
    mu = vectorize_graph(response(paper.chain(theta), record), {theta: thetas})
    fused = mean_square_discrepancy(mu, data)
    assert PopulationDiscrepancy in our_ops([fused])
    np.testing.assert_allclose(fused.eval({thetas: values}, mode=PLAIN), expected, rtol=1e-12)


def test_wrong_dimensions_are_refused():
    chain = SpringMassChain(np.ones(2), 100.0, ModalDamping(0.02))
    inputs = response(chain, Record([0.0, 1.0], DT)).owner.inputs
    with pytest.raises(ValueError, match=r"`mass` must be \(particle, n\), got 1 dimensions"):
        PopulationDiscrepancy()(*inputs, np.zeros((2, 2)))
    rows = [x[None] for x in inputs[:4]]
    with pytest.raises(ValueError, match=r"`observed` must be \(sensor, time\), got 1 dimensions"):
        PopulationDiscrepancy()(*rows, *inputs[4:], np.zeros(2))


def test_frequencies_far_below_the_highest_keep_their_digits(ground):
    """Long chains, soft springs, light masses: their quotients belong to the eigenvalues they replace."""
    rng = np.random.default_rng(11)
    n = 40
    mass, stiffness, rayleigh, ratios = population(rng, LANES + 2, n)
    stiffness[::2, :3] *= 1e-3
    mass[1::3, 30:] *= 1e-4
    common = (ground, DT, 1, 1, np.array([0, 20, 39]), n, 3)
    data = np.zeros((3, ground.size))
    np.testing.assert_allclose(*both(mass, stiffness, rayleigh, ratios, *common, data), rtol=1e-9)
