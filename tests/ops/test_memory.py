"""Peak memory: fused discrepancies and gradients need none for the history, nor one for each particle."""

import pytest

from support.commands import run_python

PEAK_GROWTH = """
    import numpy as np, pymc as pm, pytensor, pytensor.tensor as pt
    from pytensor.graph.replace import vectorize_graph
    from pymc_features import CorrelatedNormal, ModalDamping, SpringMassChain, mean_square_discrepancy
    from pymc_features import paper, response, synthetic_earthquake
    from support.straight import Record
    from pymc_features.ops import long_records, misfit_statistics
    from pymc_features.simulators import FAMILIES
    from pymc_features.smc.density.evaluation import population_logp
    from support.graphs import PLAIN
    from support.kernels import discrepancy_gradient, population_gradient, response_tangent
    from support.memory import growth

    n, n_times = 10, 400_000
    rng = np.random.default_rng(0)
    ground, measured = rng.normal(size=n_times), rng.normal(size=(n, n_times))

    # the kernels of gradients
    chain = [np.ones(n), np.full(n, 1800.0), np.array([0.1, 1e-3]), np.zeros(n)]
    rows = [x[None] for x in chain]

    def calls(length):
        more = [ground[:length].copy(), 0.02, 1, 1, np.arange(n), n, 0]
        history = measured[:, :length].copy()
        return (
            lambda: discrepancy_gradient(*chain, *more, history, np.ones(n)),
            lambda: population_gradient(*rows, *more, history, np.ones((1, n))),
            lambda: response_tangent(*chain, *more, *chain),
        )

    for function in calls(5):
        function()  # compiles
    print(*(growth(function)[0] / measured.nbytes for function in calls(n_times)))

    # the discrepancy in a graph
    shortest = long_records.FEWEST_ALONE
    long_records.FEWEST_ALONE = np.inf  # a table of the data takes some times their size, once
    node = response(SpringMassChain(np.ones(n), 1800.0, ModalDamping(0.05)), Record(np.ones(5), 0.02)).owner
    record = pytensor.shared(np.ones(5), shape=(None,))
    data = pytensor.shared(np.ones((n, 5)), shape=(n, None))
    names = FAMILIES["chain"].inputs
    mu = node.op(*(record if name == "acceleration" else x for name, x in zip(names, node.inputs)))
    fused = pytensor.function([], mean_square_discrepancy(mu, data), mode="NUMBA")
    unfused = pytensor.function([], ((mu - data) ** 2).mean(axis=-1), mode=PLAIN)
    fused(), unfused()  # compiles, on five samples
    record.set_value(ground, borrow=True)
    data.set_value(measured, borrow=True)
    (grown, one), (control, other) = growth(fused), growth(unfused)
    np.testing.assert_allclose(one, other, rtol=1e-11)
    print(grown / measured.nbytes, control / measured.nbytes)
    long_records.FEWEST_ALONE = shortest

    # populations
    def evaluations(change, *modes):
        with pm.Model() as model:
            mu = change(response(paper.chain(pm.Normal("theta", 1.0)), record))
            CorrelatedNormal("y", mu, 1.0, 0.1, record.dt, observed=change(data))
        start = model.initial_point()
        return [population_logp(model, start, {"mode": mode}) for mode in modes]

    record = synthetic_earthquake(31.18, 0.002, random_seed=1)
    data = rng.normal(size=(10, record.n_times))
    function, translated = evaluations(lambda mu: mu, "FAST_COMPILE", "NUMBA")
    (control,) = evaluations(lambda mu: mu[::-1], "FAST_COMPILE")
    particles = np.linspace(0.5, 1.5, 100)[:, None]
    fused, one = growth(lambda: function(particles)[1])
    unfused, other = growth(lambda: control(particles)[1])
    np.testing.assert_allclose(one, other, rtol=1e-9)
    found = [logp.gradient(particles[:2]) for logp in (translated, function, control)]
    slope, _ = growth(lambda: translated.gradient(particles[:64]))
    for got, exact, other in zip(*found, strict=True):
        np.testing.assert_allclose(got, exact, rtol=1e-9, atol=1e-9 * abs(exact).max())
        np.testing.assert_allclose(other, exact, rtol=1e-9, atol=1e-9 * abs(exact).max())
    theta, batch = pt.dscalar(), pt.dvector()
    alone = misfit_statistics(response(paper.chain(theta), record), data).sum()
    together = vectorize_graph(alone, {theta: batch}).sum()
    derivative = pytensor.function([batch], pt.grad(together, batch), mode=PLAIN)
    derivative(particles[:2, 0])  # compiles
    gradient, _ = growth(lambda: derivative(particles[:, 0]))
    print(fused / data.nbytes, gradient / data.nbytes, unfused / data.nbytes)
    unfused, _ = growth(lambda: control.gradient(particles[:16]))
    print(slope / data.nbytes, unfused / data.nbytes)
"""


@pytest.mark.processes
def test_peaks_do_not_grow_with_histories_and_particles(tmp_path):
    """Growth of the peak over the size of the data, in one process; what needs histories is the control.

    Of gradients and of a discrepancy, which copy the record, a tenth of the data. Of 100 particles, where two
    tables of the data take a few histories. Of gradients of 64 by four statistics, by machine code, which
    keep the history of one at a time.
    """
    pytest.importorskip("resource")
    gradients, discrepancy, populations, slopes = run_python(PEAK_GROWTH, tmp_path).splitlines()
    single, batch, forward = map(float, gradients.split())
    assert max(single, batch) < 0.15 and forward > 0.9
    fused, unfused = map(float, discrepancy.split())
    assert fused < 0.15 and unfused > 0.9
    fused, gradient, unfused = map(float, populations.split())
    assert max(fused, gradient) < 12.0 and unfused > 30.0
    fused, unfused = map(float, slopes.split())
    assert fused < 2.0 and unfused > 16.0
