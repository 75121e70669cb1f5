"""What the package uses of PyMC, PyTensor and Numba that these keep for themselves: docs/private_hooks.md."""

import importlib
import importlib.metadata
import importlib.util
import inspect
import re
from pathlib import Path

import pytensor
import pytest
from pymc.smc.kernels import SMC_KERNEL

from support.private_names import PACKAGE, inherited_names, listed_hooks, source, used_hooks

pytestmark = pytest.mark.default_mode
HOOKS = listed_hooks()


def is_there(name: str) -> bool:
    """Whether a library still has a module, a member of one or of a class, or sets it in a method of it."""
    *parts, last = name.split(".")
    if "jax" in parts:  # which starts threads, and other tests fork
        file = Path(pytensor.__file__).parent.joinpath(*parts[1:]).with_suffix(".py")
        return f"def {last}(" in file.read_text()
    for n in range(len(parts), 0, -1):
        try:
            holder = importlib.import_module(".".join(parts[:n]))
        except ImportError:
            continue
        for part in parts[n:]:
            holder = getattr(holder, part)
        if not inspect.isclass(holder):
            return hasattr(holder, last) or importlib.util.find_spec(name) is not None
        return any(last in vars(kind) or f"self.{last} = " in source(kind) for kind in holder.__mro__)
    return False


def verify(hook):
    """Fail with what broke, and where it is felt."""
    library = hook.name.partition(".")[0]
    if not is_there(hook.name):
        pytest.fail(
            f"{hook.name} is not in {library} {importlib.metadata.version(library)}. "
            f"{', '.join(sorted(hook.files))} in pymc_features use it: "
            f"{hook.why}. Without it: {hook.without}. See docs/private_hooks.md."
        )


@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: hook.name)
def test_hook(hook):
    verify(hook)


@pytest.mark.parametrize("name", ["_reset_state", "_nothing"])
def test_hook_that_is_gone_is_noticed(name, monkeypatch):
    """One that is taken away, and one that never was."""
    hook = HOOKS[0]._replace(name=f"pymc.smc.kernels.SMC_KERNEL.{name}")
    monkeypatch.delattr(SMC_KERNEL, name, raising=False)
    with pytest.raises(pytest.fail.Exception, match=re.escape(f"{hook.name} is not in pymc")):
        verify(hook)


@pytest.mark.slow
def test_every_hook_in_use_is_listed():
    listed = {(name, file) for hook in HOOKS for file in hook.files for name in (hook.name, hook.last)}
    unlisted = used_hooks() - listed
    assert unlisted == set(), f"write a row in docs/private_hooks.md for {sorted(unlisted)}"


def test_every_hook_on_the_list_is_in_use():
    for hook in HOOKS:
        for file in hook.files:
            used = re.search(rf"\b{hook.last}\b", (PACKAGE / file).read_text())
            assert used, f"{file} does not use {hook.name}: take it off docs/private_hooks.md"


class Unlisted(SMC_KERNEL):
    """Overrides what the list does not have."""

    def _progressbar_config(self):
        return self._something_of_ours()

    def _something_of_ours(self):
        return None


def test_hooks_that_are_not_listed_are_found(tmp_path):
    (tmp_path / "bad.py").write_text(
        "import numba.core.errors\n"
        "from pymc.util import _get_seeds_per_chain\n"
        "from pytensor.link.basic import Linker\n"
        "from pymc.math import exp\n"
        "def use(x, name='_distance'):\n"
        "    x._ours = x.tag.test_value\n"
        "    return x._ours, x._theirs, x._replace()\n"
    )
    names = {name for name, file in used_hooks(tmp_path, kinds=[]) if file == "bad.py"}
    assert names == {
        *("numba.core.errors", "pymc.util._get_seeds_per_chain", "pytensor.link.basic.Linker"),
        *("_distance", "tag", "_theirs"),
    }


def test_overrides_that_are_not_listed_are_found():
    assert inherited_names(Unlisted) == {"_progressbar_config"}
