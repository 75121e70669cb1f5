"""What is expected of each private hook of PyMC."""

import functools
import inspect
import multiprocessing
import warnings
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest

import pymc_features as pmf
from pymc_features.likelihoods import gaussian
from pymc_features.likelihoods import mean_square as feature
from support.hooks.checks import INTERPRETED, attributes_read, check


@check("pymc.logprob.abstract._logprob")
def log_density():
    assert pm.logprob.abstract._logprob.dispatch(feature.FeatureRV) is feature.feature_logprob


@check("pymc.logprob.abstract._logcdf")
def log_probability():
    assert pm.logprob.abstract._logcdf.dispatch(feature.FeatureRV) is feature.feature_logcdf


@check("pymc.distributions.distribution._support_point")
def start():
    assert (
        pm.distributions.distribution._support_point.dispatch(feature.FeatureRV)
        is feature.feature_support_point
    )


@check("pymc.distributions.distribution.SymbolicRandomVariable._print_name")
def printed_name():
    assert isinstance(pm.distributions.distribution.SymbolicRandomVariable._print_name, tuple)
    with pm.Model() as model:
        pmf.ExpFeature("y", mu=pt.zeros((3, 9)), sigma=1.0)
    assert "ExpFeature" in model.str_repr()


@check("pymc.distributions.distribution.Continuous.rv_op")
def method_of_a_distribution():
    assert vars(pm.Continuous)["rv_op"] is None
    assert vars(pmf.ExpFeature)["rv_op"] is vars(feature.FeatureLikelihood)["rv_op"]


@check("pymc.distributions.simulator.SimulatorRV._distance")
def distance_of_a_simulator():
    from pymc.distributions import simulator

    assert hasattr(simulator.SimulatorRV, "_distance")
    with pm.Model():
        node = pm.Simulator("y", lambda rng, size: np.zeros(2), distance="laplace", observed=np.zeros(2))
    assert type(node.owner.op)._distance is simulator.laplace


@check("pymc.Normal.logp", "pymc.logprob.utils.CheckParameterValue")
def form_of_the_gaussian_density():
    from pymc.logprob.utils import CheckParameterValue

    value, mu, sigma = pt.dmatrix("value"), pt.dmatrix("mu"), pt.dcol("sigma")
    density = pm.Normal.logp(value, mu, sigma)
    assert isinstance(density.owner.op, CheckParameterValue)
    known, gaussian.response_node = gaussian.response_node, lambda mu: mu.owner or mu
    try:
        assert gaussian.gaussian_summand(density) == (value, mu, sigma)
    finally:
        gaussian.response_node = known


@check(
    "pymc.logprob.utils.local_check_parameter_to_ninf_switch",
    "pymc.logprob.utils.local_remove_check_parameter",
)
def rewrites_of_parameter_checks():
    from pymc.logprob.utils import local_check_parameter_to_ninf_switch, local_remove_check_parameter
    from pytensor.graph.fg import FunctionGraph
    from pytensor.graph.rewriting.basic import dfs_rewriter

    sigma = pt.dscalar("sigma")
    for rewrite, wanted in (
        (local_check_parameter_to_ninf_switch, -np.inf),
        (local_remove_check_parameter, np.nan),
    ):
        graph = FunctionGraph([sigma], [pm.Normal.logp(0.0, 0.0, sigma)], clone=False)
        dfs_rewriter(rewrite).rewrite(graph)
        found = pytensor.function([sigma], graph.outputs[0], mode=INTERPRETED)(-1.0)
        np.testing.assert_equal(float(found), wanted)


@functools.cache
def small_model():
    with pm.Model(coords={"entry": ["a", "b"]}) as model:
        x = pm.HalfNormal("x", dims="entry")
        pm.Normal("y", x, 1.0, observed=[1.0, 2.0])
    return model


@check("pymc.initial_point.make_initial_point_expression")
def initial_points():
    from pymc.initial_point import make_initial_point_expression

    model = small_model()
    [drawn] = make_initial_point_expression(
        free_rvs=model.free_RVs,
        rvs_to_transforms=model.rvs_to_transforms,
        initval_strategies=model.rvs_to_initial_values,
        default_strategy="prior",
        return_transformed=True,
    )
    assert drawn.type.ndim == 1


@functools.cache
def kernel(kind):
    return kind(20, model=small_model(), random_seed=1)


@check("pymc.smc.kernels.SMC_KERNEL")
def smc_kernels():
    """Every attribute that methods of PyMC's kernels read is there, without their `__init__`."""
    from pymc.smc import IMH, MH
    from pymc.smc.kernels import SMC_KERNEL

    for theirs, ours in ((IMH, pmf.sampling.PopulationIMH), (MH, pmf.sampling.PopulationMH)):
        made = kernel(ours)
        methods = {name: getattr(ours, name) for base in (SMC_KERNEL, theirs) for name in vars(base)}
        inherited = [
            f for f in methods.values() if inspect.isfunction(f) and f.__module__ == SMC_KERNEL.__module__
        ]
        assert {"resample", "step", "tune", "update_beta_and_weights"} <= {f.__name__ for f in inherited}
        unused = {"initialize_population"}  # called by what ours replaces
        made.initialize(None, np.random.default_rng(1))
        made.update_beta_and_weights()
        made.resample()
        for method in inherited:
            missing = {n for n in attributes_read(method) if not hasattr(made, n)}
            assert not missing or method.__name__ in unused, f"{method.__qualname__} reads {missing}"
        made.tune()
        made.propose()


@check("pymc.smc.kernels.SMC_KERNEL._reset_state", "pymc.smc.kernels.SMC_KERNEL._initialize_kernel")
def steps_of_a_chain():
    from pymc.smc.kernels import SMC_KERNEL

    assert callable(SMC_KERNEL._reset_state)
    assert callable(SMC_KERNEL._initialize_kernel)
    assert {"_reset_state", "set_rng", "_initialize_kernel"} <= attributes_read(SMC_KERNEL.initialize)


@check("pymc.smc.sampling._build_trace_from_kernel_state")
def traces_of_chains():
    from pymc.smc import sampling

    names = list(inspect.signature(sampling._build_trace_from_kernel_state).parameters)
    assert names == ["tempered_posterior", "var_info", "variables", "chain", "model"]
    for function in (sampling._sample_smc_sequentially, sampling.sample_smc):
        assert "_build_trace_from_kernel_state" in function.__code__.co_names


@check("pymc.smc.sampling._sample_smc_sequentially")
def chains_of_a_run():
    from pymc.smc import sampling

    names = {"kernel", "chains", "rngs", "start_points", "model", "progressbar", "progressbar_theme"}
    names |= {"traces", "sample_stats", "sample_settings"}
    assert set(inspect.signature(sampling._sample_smc_sequentially).parameters) == names
    assert "_sample_smc_sequentially" in sampling.sample_smc.__code__.co_names


@check("pymc.backends.ndarray.NDArray")
def trace_in_memory():
    from pymc.backends import ndarray

    with pm.Model() as model:
        pm.Normal("x")
    shapes, dtypes = {"x": (2,)}, {"x": np.dtype(float)}
    trace = ndarray.NDArray(model=model, fn=lambda x: [x], var_shapes=shapes, var_dtypes=dtypes)
    trace.setup(3, 0)
    assert trace.samples["x"].shape == (3, 2) and (trace.draws, trace.draw_idx) == (3, 0)


@check("pymc.sampling.parallel.ParallelSamplingError")
def error_of_a_chain():
    """It is raised from what was raised in the process of the chain."""
    from pymc.sampling.parallel import ParallelSamplingError
    from pymc.smc.parallel import SMCProcessAdapter

    receiver, sender = multiprocessing.Pipe(duplex=False)
    with receiver, sender, pytest.raises(ParallelSamplingError) as raised:
        sender.send(("error", ValueError("of the chain")))
        SMCProcessAdapter.recv_message([SimpleNamespace(_msg_pipe=receiver, chain=0)])
    assert str(raised.value.__cause__) == "of the chain"


@check("pymc.step_methods.hmc.quadpotential.QuadPotentialFullAdapt")
def mass_matrix():
    from pymc.step_methods.hmc.quadpotential import QuadPotentialFullAdapt

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        potential = QuadPotentialFullAdapt(2, np.zeros(2), 4.0 * np.eye(2), initial_weight=10)
    np.testing.assert_allclose(potential.velocity(np.ones(2)), 4.0)
