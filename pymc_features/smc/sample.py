"""`sample_smc`: PyMC's function with a better default kernel and a result that can be saved."""

import copy
import json
import os
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue
from types import FunctionType

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pymc.backends.ndarray import NDArray
from pymc.distributions.simulator import SimulatorRV
from pymc.progress_bar import SMCProgressBarManager
from pymc.pytensorf import compile as compile_function
from pymc.sampling.parallel import ParallelSamplingError
from pymc.smc.kernels import SMC_KERNEL
from pymc.smc.sampling import _build_trace_from_kernel_state as draw_by_draw
from pymc.smc.sampling import _sample_smc_sequentially as one_after_another
from pymc.util import RandomState
from pymc.vartypes import discrete_types
from pytensor.graph.basic import Constant
from pytensor.graph.replace import vectorize_graph
from pytensor.graph.traversal import ancestors

from pymc_features._checks import (
    check_flag,
    check_integer,
    check_model,
    check_path,
    check_seed,
    message,
    shown,
)
from pymc_features.exceptions import CheckpointError, NoSpreadError, ToleranceNotReachedError
from pymc_features.external.workers.calls import one_thread_each
from pymc_features.smc.density.graph import is_random, largest_result, nodes_of, simulator_functions
from pymc_features.smc.density.rows import BATCH_BYTES, with_mode
from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.kernels.checkpoint import remembered
from pymc_features.smc.kernels.persistent import PersistentSMC
from pymc_features.smc.workers import Workers, check_workers, open_workers

MOST_RUNS = 10_000  # chains, or processes


def sample_smc(
    draws: int = 2000,
    kernel: type[SMC_KERNEL] = PersistentSMC,
    *,
    chains: int | None = None,
    cores: int | None = None,
    random_seed: RandomState = None,
    checkpoint: str | os.PathLike | None = None,
    executor: int | str | Executor | None = None,
    **settings,
) -> xr.DataTree:
    """`pm.sample_smc` with `PersistentSMC` by default and a result that saves to netCDF and Zarr.

    Parameters
    ----------
    draws : int
        Draws of each chain.
    kernel : type
        Any kernel of `pm.sample_smc`.
    chains : int, optional
        As many as processors, and at least two, by default.
    cores : int, optional
        Chains in parallel; as many as there are processors by default, and one for a model with an
        `ExternalSimulator`, which is parallel by itself. Where JAX has been used, pass
        mp_ctx="forkserver": a fork may hang.
    random_seed : int or sequence of int, optional
        For the same particles each time.
    checkpoint : path-like, optional
        Folder that keeps every evaluation, for the kernels of this package. A run that was killed at any
        moment and is started again goes on from there, with the same seed, and ends with the particles that
        it would have had. Remove the folder when it is done.
    executor : int, str, dask Client or Executor, optional
        Where populations are evaluated, for the kernels of this package: number of local processes, address
        of a Dask scheduler, or any object with `submit` as of `concurrent.futures`. The chains share it, all
        at once or `cores` of them; the particles are those of one process, bit for bit, on processors of one
        kind. By default each chain is evaluated in its own process.
    **settings
        Of `pm.sample_smc` (`model`, `progressbar`, `mp_ctx`, ...) and of the kernel.

    Returns
    -------
    DataTree
        As from `pm.sample_smc`, but `sample_stats` holds float arrays (chain, stage), padded with NaN, and
        `log_marginal_likelihood` (chain,). The attribute `likelihoods` says what each is a density of.

    Raises
    ------
    ToleranceNotReachedError
        From `SubsetSimulation`.
    CheckpointError
        If the checkpoint is damaged, in use, or of another run.
    RuntimeError
        If a process dies that samples a chain.
    NoWorkersError
        If an executor runs nothing any more, or its processes die again and again with the same particles.

    Examples
    --------
    >>> import pymc as pm
    >>> with pm.Model():
    ...     x = pm.Normal("x")
    ...     y = pm.Normal("y", x, 1.0, observed=[1.0])
    ...     idata = sample_smc(200, chains=2, cores=1, random_seed=1, progressbar=False)
    >>> idata.sample_stats["log_marginal_likelihood"].dims
    ('chain',)
    """
    check_run(draws, chains, cores, random_seed, settings.get("progressbar", True))
    if not (isinstance(kernel, type) and issubclass(kernel, SMC_KERNEL)):
        advice = "Pass the class, for example PersistentSMC."
        raise TypeError(message("kernel", "a kernel of `pm.sample_smc`", shown(kernel), advice))
    check_workers(executor)
    model = check_model(settings.get("model"))
    if settings.pop("return_inferencedata", True) is not True:
        raise ValueError(
            "`return_inferencedata` must be True, got False. Use pm.sample_smc() for a MultiTrace."
        )
    default_chains = max(2, cores or processors())
    for name, given in (("checkpoint", checkpoint), ("executor", executor)):
        if given is not None and not issubclass(kernel, PopulationKernel):
            raise TypeError(
                f"`{name}` must be left out for {kernel.__name__}, which has none. Use a kernel of "
                "pymc_features."
            )
    if checkpoint is not None:
        check_path(checkpoint, "checkpoint")
        random_seed, chains = remembered(checkpoint, random_seed, chains, default_chains)
        settings["checkpoint"] = checkpoint
    if chains is None:
        chains = default_chains
    at_once = min(cores or chains, chains)
    if executor is not None:
        cores = 1  # process; chains in threads
    elif cores is None:
        cores = 1 if is_parallel_by_itself(model) else processors()
    try:
        with open_workers(executor) as workers, one_thread_each():
            found = sampler(workers, at_once)(
                draws, kernel, chains=chains, cores=cores, random_seed=random_seed, **settings
            )
        idata = savable(found)
    except ParallelSamplingError as error:
        # the same with one process and with many
        if isinstance(error.__cause__, ToleranceNotReachedError | CheckpointError | NoSpreadError):
            raise error.__cause__ from None
        raise
    except (EOFError, ConnectionResetError) as error:
        raise RuntimeError(
            "a process that sampled a chain died: killed, or out of memory. Sample with fewer `cores` or "
            "`draws`; with `checkpoint` the next run goes on from there."
        ) from error
    idata["sample_stats"].attrs["likelihoods"] = likelihood_kinds(model)
    return idata


def check_run(draws, chains, cores, random_seed, progressbar) -> None:
    """Refuse sizes of a run that are no sizes."""
    check_integer(draws, "draws", least=2)
    for name, value in (("chains", chains), ("cores", cores)):
        if value is not None:
            check_integer(value, name, most=MOST_RUNS)
    n = max(2, cores or processors()) if chains is None else chains
    if np.ndim(check_seed(random_seed, states=True)) and len(random_seed) != n:
        wanted = f"one integer, or one for each of the {n} chains"
        raise ValueError(message("random_seed", wanted, f"{len(random_seed)} integers"))
    check_flag(progressbar, "progressbar")


def is_parallel_by_itself(model) -> bool:
    """Whether something in the model takes many processors for one chain."""
    for v in ancestors([*model.basic_RVs, *model.potentials]):
        op = getattr(v.owner, "op", None)
        fn = op.fn if isinstance(op, SimulatorRV) else None  # another Op may compile itself if asked for `fn`
        inner = getattr(getattr(fn, "simulator", fn), "op", None)  # with noise there is another inside
        if getattr(op, "expensive", False) or getattr(inner, "expensive", False):
            return True
    return False


def processors() -> int:
    """Number of processors that this process may use."""
    return os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()


PER_CHAIN = ("log_marginal_likelihood", "log_marginal_likelihood_se", "ess", "pareto_k", "largest_share")


def savable(idata: xr.DataTree) -> xr.DataTree:
    """Return the result with per-stage statistics as float arrays (chain, stage), padded with NaN.

    With more than one chain, `pm.sample_smc` returns them as object arrays or lists of unequal lengths,
    which neither netCDF nor Zarr can hold.

    Parameters
    ----------
    idata : DataTree
        As `pm.sample_smc` returns it; left as it is.

    Returns
    -------
    DataTree
        The same groups; `sample_stats` has the dimensions (chain, stage), but for
        `log_marginal_likelihood`, its standard error, `ess`, `pareto_k` and `largest_share`, which belong to
        the chain.
    """
    result = idata.copy()
    if "sample_stats" not in result.children:
        return result
    stats = result["sample_stats"].to_dataset()
    chains = np.atleast_1d(result["posterior"]["chain"].values)
    of_chains = {  # lists of unequal lengths, or of one chain what belongs to it
        name: [
            np.ravel(np.asarray(row, dtype=float)) for row in (v.values if len(chains) > 1 else [v.values])
        ]
        for name, v in stats.data_vars.items()
    }
    n_stages = max((len(row) for rows in of_chains.values() for row in rows), default=0)
    data = {}
    for name, rows in of_chains.items():
        if name in PER_CHAIN:
            data[name] = "chain", [next(iter(row[~np.isnan(row)][::-1]), np.nan) for row in rows]
        else:
            padded = [np.pad(row, (0, n_stages - len(row)), constant_values=np.nan) for row in rows]
            data[name] = ("chain", "stage"), np.array(padded)
    attrs = {  # netCDF holds no others
        key: value if isinstance(value, str | int | float | np.number) else str(value)
        for key, value in stats.attrs.items()
    }
    coords = {"chain": chains, "stage": np.arange(n_stages)}
    result["sample_stats"] = xr.DataTree(xr.Dataset(data, coords=coords, attrs=attrs))
    return result


def likelihood_kinds(model) -> str:
    """What each likelihood of a model is a density of, as JSON: by this evidences can be compared.

    "data" of PyMC's distributions and of ours with ``density="data"``; the class of those of a feature; of a
    simulator node the tolerance.
    """
    return json.dumps({rv.name: kind_of_density(rv.owner.op) for rv in model.observed_RVs}, sort_keys=True)


def kind_of_density(op) -> str:
    """What one likelihood is a density of."""
    if isinstance(op, SimulatorRV):
        epsilon = op.epsilon.data.tolist() if isinstance(op.epsilon, Constant) else "of pm.Data"
        return f"simulator with tolerance {epsilon}"
    density = getattr(op, "density", "data")
    return "data" if density == "data" else f"{density} of {type(op).__name__.removesuffix('RV')}"


def trace_function(model) -> Callable[[list], dict[str, np.ndarray]] | None:
    """What a trace holds of a model, of many draws at once: all variables (draw, ...) by name.

    From those of `model.value_vars`. None if something in the model takes one draw at a time, or draws random
    numbers itself.
    """
    values, variables = model.value_vars, model.unobserved_value_vars
    rest = [v for v in variables if v not in values]
    nodes = nodes_of(rest)
    if simulator_functions(nodes) or any(map(is_random, nodes)):
        return None
    inputs = [pt.tensor(v.name, dtype=v.dtype, shape=(None, *v.type.shape)) for v in values]
    try:
        outputs = vectorize_graph(rest, dict(zip(values, inputs, strict=True)))
    except Exception:  # any Op of any library may refuse in its own way
        return None
    outputs = [
        new if new.ndim > old.ndim else pt.broadcast_to(new, (inputs[0].shape[0], *new.shape))
        for new, old in zip(outputs, rest, strict=True)
    ]
    function = compile_function(inputs, outputs, on_unused_input="ignore", **with_mode({}, outputs))
    batch = max(1, BATCH_BYTES // (8 * largest_result(values, rest)))

    def all_variables(draws: list) -> dict[str, np.ndarray]:
        parts = [function(*(x[i : i + batch] for x in draws)) for i in range(0, len(draws[0]), batch)]
        found = dict(zip([v.name for v in values], draws, strict=True))
        found |= zip([v.name for v in rest], map(np.concatenate, zip(*parts, strict=True)), strict=True)
        return {v.name: found[v.name] for v in variables}

    return all_variables


def trace_builder() -> Callable[..., NDArray]:
    """A function that writes the trace of a chain in one call, or draw by draw where that is not possible.

    It takes what `_build_trace_from_kernel_state` of PyMC's takes.
    """
    functions = {}

    def build_trace(tempered_posterior, var_info, variables, chain, model):
        if model not in functions:
            functions[model] = trace_function(model)
        if functions[model] is None:
            return draw_by_draw(tempered_posterior, var_info, variables, chain, model)
        draws, first = [], 0
        for v in variables:
            shape, size = var_info[v.name]
            values = tempered_posterior[:, first : first + size].reshape(-1, *shape)
            draws.append((np.round(values) if v.dtype in discrete_types else values).astype(v.dtype))
            first += size
        found = functions[model](draws)
        trace = NDArray(
            name=model.name,
            model=model,
            fn=lambda *point: [x[0] for x in functions[model]([np.asarray(x)[None] for x in point]).values()],
            var_shapes={name: x.shape[1:] for name, x in found.items()},
            var_dtypes={name: x.dtype for name, x in found.items()},
        )
        trace.setup(len(draws[0]), chain)
        trace.samples.update({name: np.ascontiguousarray(x) for name, x in found.items()})
        trace.draw_idx = trace.draws
        return trace

    return build_trace


LOOK_SECONDS = 1.0


def sampler(workers: Workers | None, most: int) -> Callable[..., xr.DataTree]:
    """`pm.sample_smc` with traces written in one call, and chains on workers, up to `most` at once.

    Each chain has a kernel and random numbers of its own, so that its draws do not depend on the others.
    """
    build_trace = trace_builder()

    def side_by_side(*, kernel, chains, rngs, start_points, model, traces, **rest):
        ends = run_chains(kernel, start_points, rngs, most, workers, rest)
        for number, (own, stats) in enumerate(ends):
            traces.append(build_trace(own.tempered_posterior, own.var_info, own.variables, number, model))
            rest["sample_stats"].append(stats)
            rest["sample_settings"].append(own.sample_settings())

    names = {"_build_trace_from_kernel_state": build_trace}
    in_turn = with_names(one_after_another, names) if workers is None else side_by_side
    return with_names(pm.sample_smc, names | {"_sample_smc_sequentially": in_turn})


def with_names(function: Callable, names: dict) -> Callable:
    """A copy of a function in which names of its module mean something else; the module stays as it is."""
    own = FunctionType(function.__code__, function.__globals__ | names, argdefs=function.__defaults__)
    own.__kwdefaults__ = function.__kwdefaults__
    return own


def run_chain(number, kernel, start, rng, told: SimpleQueue) -> tuple[PopulationKernel, dict]:
    """A kernel at the posterior, and its statistics; what the progress bar shows goes to `told`."""
    stats, stage = {name: [] for name in kernel.stats_dtypes_shapes}, 0
    kernel.initialize(start, rng)
    while kernel.beta < 1:
        before = kernel.beta
        kernel.update_beta_and_weights()
        told.put({"stage": stage, "beta": kernel.beta, "old_beta": before, "chain_idx": number})
        for name, value in kernel.step().items():
            stats[name].append(value)
        stage += 1
    last = {"stage": stage, "beta": kernel.beta, "old_beta": kernel.beta, "is_last": True}
    told.put({**last, "chain_idx": number})
    return kernel, stats


def run_chains(kernel, start_points, rngs, most, workers, bars) -> list[tuple[PopulationKernel, dict]]:
    """Kernels and statistics of all chains, when they are over; the first error, or Ctrl-C, ends them all."""
    run, told, kernels = workers.run(), SimpleQueue(), [copy.copy(kernel) for _ in rngs]
    for own in kernels:
        own.evaluate_by(run.of)
    settings = {name: bars[name] for name in ("progressbar", "progressbar_theme")}
    with (
        SMCProgressBarManager(kernel=kernel, chains=len(kernels), **settings) as shown,
        ThreadPoolExecutor(most, thread_name_prefix="chain") as pool,
    ):
        try:
            chains = zip(range(len(kernels)), kernels, start_points, rngs, strict=True)
            futures = [pool.submit(run_chain, *chain, told) for chain in chains]
            for future in futures:
                future.add_done_callback(told.put)
            left = len(futures)
            while left:  # woken up now and then, for Ctrl-C
                with suppress(Empty):
                    news = told.get(timeout=LOOK_SECONDS)
                    if isinstance(news, dict):
                        shown.update(**news)
                    else:
                        news.result()
                        left -= 1
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            run.stop()
            raise
    return [future.result() for future in futures]
