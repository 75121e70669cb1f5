"""Packages that build on PyMC, on the model of the README; those that are not installed are not tried."""

import pytest

from support.pages import README, blocks


@pytest.mark.neighbours
def test_pathfinder_of_pymc_extras():
    """It underestimates the width of a bent posterior, but finds its place."""
    pmx = pytest.importorskip("pymc_extras")
    code = blocks(README, "python")[0]
    model, sampled = code.split("    idata = ")
    assert sampled.startswith("pmf.sample_smc(")
    names = {}
    exec(model, names)
    with names["model"]:
        idata = pmx.fit("pathfinder", random_seed=1, num_draws=500, num_paths=4)
    posterior = idata.posterior
    assert posterior["theta"].size == 500
    assert abs(float(posterior["theta"].mean()) - 0.9995) < 0.0045  # a standard deviation
    assert 0.143 < float(posterior["sigma"].mean()) < 0.251
