"""Where tests find data, and which record they use."""

import functools
import gc
import os
import re
import socket
import sys
from pathlib import Path

import pytest

gc.disable()  # until all is imported, of which nothing is garbage
_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
if "PYMC_FEATURES_DATA" not in os.environ and _BESIDE.is_dir():
    os.environ["PYMC_FEATURES_DATA"] = str(_BESIDE)
os.environ.setdefault("MPLBACKEND", "Agg")
# tests run side by side: with more threads than processors those of linear algebra wait for each other
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
# kernels of LLVM's level 3, which is Numba's, are as fast within 5 % and take a third longer to compile
os.environ.setdefault("NUMBA_OPT", "2")
# PyTensor notes for each node of a graph where it was made, a fifth of the time of building one; and in
# FAST_COMPILE it compiles C++, a second for each new kind of node
os.environ["PYTENSOR_FLAGS"] = ",".join(
    filter(None, [os.environ.get("PYTENSOR_FLAGS"), "traceback__limit=0,cxx="])
)
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # else each of the many processes that the tests start compiles all that it imports, PyMC in 7 s
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(Path(cache) / "pymc_features" / "bytecode")
    sys.dont_write_bytecode = False


NOT_QUICK = {"neighbours", "notebook", "statistical", "processes", "slow"}
RUNS = {"finished", "updated"}  # fixtures that wait for a whole run, which takes seconds

# in this order after all others: JAX starts threads, and others fork; the rest run in their own processes,
# the longest first, so that a worker that has taken one more than the other ends soon
LAST = ["test_jax.py", "test_pages.py", "test_recipes.py", "test_notebooks.py", "test_reference.py"]


KERNELS = "simulators", "dynamics", "ops"  # whose tests compile most kernels
YIELDING = re.compile("cyclic|hysteretic|nonlinear|spans|springs|taylor")  # few parts in common
CROSS_CHECKED = {"inference", "test_building_example.py"}
FEW_KERNELS = {"io", "identification", "signals", "modal", "external", "events"}
FEW_KERNELS |= {"test_layout.py", "test_odd_arguments.py", "test_cli.py", "test_packaging.py"}


def of(path, names):
    """Whether a file, or its folder, is one of those named."""
    return path.name in names or path.parent.name in names


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """What is quick, and the order of the tests: kernels first, to compile them for the others.

    Two workers share them; the next to come runs tests that need few. So workers end together.
    """

    def place(item):
        path = item.path
        if path.name in LAST:
            order = LAST.index(path.name)
        elif of(path, KERNELS):
            order = -3
        else:
            order = -2 if of(path, FEW_KERNELS) or path.stem.endswith("_statistics") else -1
        file = item.callspec.params["path"] if "notebook" in item.keywords else path
        return order, -file.stat().st_size

    items.sort(key=place)
    for item in items:
        marks, fixtures = {mark.name for mark in item.iter_markers()}, set(getattr(item, "fixturenames", ()))
        if not marks & NOT_QUICK and not fixtures & RUNS:
            item.add_marker("quick")


def pytest_collection_finish():
    """Look for garbage less often, and not at all in what is imported, which stays."""
    from support.commands import GARBAGE

    gc.freeze()
    gc.set_threshold(*GARBAGE)
    gc.enable()


@functools.cache
def quick_mode(all_rewrites):
    """PyTensor's FAST_COMPILE; without its longest rewrites, which are half of the time to compile.

    They make a function a third faster: tests that call one many thousand times have them. One of them makes
    a density -inf outside of its support, and stays. (Without them some constants are of single precision.)
    """
    from pymc.logprob.utils import local_check_parameter_to_ninf_switch
    from pytensor.compile.mode import FAST_COMPILE
    from pytensor.graph.rewriting.basic import dfs_rewriter

    if all_rewrites:
        return FAST_COMPILE
    to_ninf = dfs_rewriter(local_check_parameter_to_ninf_switch)
    return FAST_COMPILE.excluding("canonicalize").register((to_ninf, 1.0))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Tests, and their fixtures, compile quickly; examples and `default_mode` as users do.

    The check behind each run of `sample`, two fifths of it, is for the tests of the sampler.
    """
    import pytensor

    if isinstance(item, pytest.DoctestItem) or item.get_closest_marker("default_mode"):
        return (yield)
    all_rewrites = any(item.get_closest_marker(name) for name in ("all_rewrites", "statistical"))
    sampler = sys.modules.get("pymc_features.inference.sample")
    with pytensor.config.change_flags(mode=quick_mode(all_rewrites)), pytest.MonkeyPatch.context() as patch:
        if sampler and not of(item.path, CROSS_CHECKED):
            patch.setattr(sampler, "cross_checked", lambda idata, *_: idata)
        return (yield)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Files stay on one worker, for the sake of their fixtures; each notebook goes to any.

    Those that compile kernels stay on one, and those of springs that yield on another: kernels have parts
    that no other worker then translates.
    """
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            path = Path(nodeid.split("::")[0])
            if of(path, KERNELS) and path.name not in LAST:
                return "kernels of springs" if YIELDING.search(path.stem) else "kernels"
            return nodeid if "::test_notebook_runs[" in nodeid else super()._split_scope(nodeid)

    return Scheduling(config, log)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the real records; tests that need it are skipped where it is absent."""
    folder = os.environ.get("PYMC_FEATURES_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("no real data: set PYMC_FEATURES_DATA to their folder")
    return Path(folder)


@pytest.fixture(scope="session")
def reference_dir(data_dir) -> Path:
    """Folder with the reference results, beside the data."""
    folder = data_dir.parent / "reference"
    if not folder.is_dir():
        pytest.skip("no reference results beside PYMC_FEATURES_DATA")
    return folder


@pytest.fixture(scope="session")
def record():
    """El Centro."""
    from pymc_features import datasets

    return datasets.el_centro()


@pytest.fixture(autouse=True)
def no_network(monkeypatch):
    """Refuse connections to other machines: the tests must pass without a network."""
    connect = socket.socket.connect

    def guarded(self, address):
        if self.family != socket.AF_UNIX and address[0] not in ("127.0.0.1", "::1", "localhost"):
            raise OSError(f"tests must not use the network, got a connection to {address}")
        return connect(self, address)

    monkeypatch.setattr(socket.socket, "connect", guarded)


@pytest.fixture(scope="module")
def browser():
    """Chromium, for tests marked by `needs_browser`; pages that move use a processor while they are open."""
    from playwright.sync_api import sync_playwright

    from support.browser import CHROMIUM

    with sync_playwright() as started:
        opened = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()
