"""What the package uses of PyMC, PyTensor and Numba that these keep for themselves: docs/private_hooks.md."""

import importlib
import importlib.metadata
import re

import pytest
from pymc.smc.kernels import SMC_KERNEL

from support.hooks import CHECKS
from support.private_names import PACKAGE, listed_hooks, used_hooks

pytestmark = pytest.mark.default_mode
HOOKS = listed_hooks()


def as_parameters(hooks):
    """Hooks by their names; that of JAX starts a process."""
    marks = {"pytensor.link.jax.dispatch.basic.jax_funcify": pytest.mark.processes}
    return [pytest.param(h, id=h.name, marks=marks.get(h.name, ())) for h in hooks]


def verify(hook):
    """Fail with what broke, and where it is felt."""
    library = hook.name.partition(".")[0]
    try:
        CHECKS[hook.name]()
    except Exception as error:
        pytest.fail(
            f"{hook.name} is not what it was, in {library} {importlib.metadata.version(library)} "
            f"({type(error).__name__}: {error}). {', '.join(sorted(hook.files))} in pymc_features use it: "
            f"{hook.why}. Without it: {hook.without}. See docs/private_hooks.md."
        )


def owner_of(name: str):
    """The module or class that holds a hook, if one does; some belong to objects only."""
    parts = name.split(".")
    for n in range(len(parts) - 1, 0, -1):
        try:
            holder = importlib.import_module(".".join(parts[:n]))
        except ImportError:
            continue
        for part in parts[n:-1]:
            holder = getattr(holder, part)
        places = getattr(holder, "__mro__", [holder])
        return next((place for place in places if parts[-1] in vars(place)), None)
    return None


@pytest.mark.parametrize("hook", as_parameters(HOOKS))
def test_hook(hook):
    verify(hook)


IN_THIS_PROCESS = [h for h in HOOKS if "jax" not in h.name and owner_of(h.name) is not None]


@pytest.mark.parametrize("hook", as_parameters(IN_THIS_PROCESS))
def test_hook_that_is_gone_is_noticed(hook, monkeypatch):
    """By the check of each, when it is taken away."""
    monkeypatch.delattr(owner_of(hook.name), hook.last)
    with pytest.raises(pytest.fail.Exception, match=re.escape(f"{hook.name} is not what it was")):
        verify(hook)


def test_every_hook_has_a_check():
    assert {hook.name for hook in HOOKS} == set(CHECKS)
    assert len(HOOKS) == len(CHECKS)
    assert len(HOOKS) - len(IN_THIS_PROCESS) < 6  # attributes of objects, and JAX's


@pytest.mark.slow
def test_every_hook_in_use_is_listed():
    listed = {(name, file) for hook in HOOKS for file in hook.files for name in (hook.name, hook.last)}
    unlisted = used_hooks() - listed
    assert unlisted == set(), f"write a row in docs/private_hooks.md, and a check, for {sorted(unlisted)}"


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
    from support.private_names import inherited_names

    assert inherited_names(Unlisted) == {"_progressbar_config"}
