"""The directive `public`: reference of the public names that some parts of the package define.

    ```{public} structures
    ```

The names come from `__all__` of the package, of the modules in it and of `MODULES`, and from the bases of
these classes, so that a new public name appears by itself. The build complains of a name without a page.
"""

import importlib
import inspect
from types import ModuleType

from docutils.parsers.rst import directives
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from tables import first_sentence

import pymc_features

# public, besides those that `pymc_features.__all__` names
MODULES = ("update", "external.umbridge", "ground_motion")
LOGGER = logging.getLogger(__name__)


def public_names() -> dict[str, str]:
    """Full name of each public object, with the folder or module below the package that defines it."""
    modules = {name: importlib.import_module(f"pymc_features.{name}") for name in MODULES}
    found = {}
    for name in pymc_features.__all__:
        value = getattr(pymc_features, name)
        if isinstance(value, ModuleType):
            modules[name] = value
        else:
            found[f"pymc_features.{name}"] = value
    for place, module in modules.items():
        for name in defined(module):
            if getattr(module, name) not in found.values():
                found[f"pymc_features.{place}.{name}"] = getattr(module, name)
    for value in [value for value in found.values() if inspect.isclass(value)]:
        for base in inspect.getmro(value):
            if base.__module__.startswith("pymc_features.") and base not in found.values():
                found[f"{base.__module__}.{base.__name__}"] = base
    return {name: value.__module__.split(".")[1] for name, value in found.items()}


def defined(module) -> list[str]:
    """Public functions and classes of a module."""
    names = getattr(module, "__all__", None)
    if names is None:  # those that come from it, and not from one that it imports
        ours = (
            n for n, x in vars(module).items() if getattr(x, "__module__", "").startswith(module.__name__)
        )
        names = [name for name in ours if not name.startswith("_")]
    return [name for name in names if callable(getattr(module, name))]


class Public(SphinxDirective):
    """A table of the public names of some parts of the package, and the reference of each."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {"members-of-bases-only": directives.flag}  # for what users take as it is

    def run(self):
        parts = self.arguments[0].split()
        data = self.env.metadata[self.env.docname]
        data["public"] = " ".join([*data.get("public", "").split(), *parts])
        names = sorted((name for name, part in public_names().items() if part in parts), key=str.lower)
        table = ["| | |", "|---|---|"]
        entries = []
        for name in names:
            value = looked_up(name)
            kind = kind_of(value)
            table.append(f"| {{py:obj}}`~{name}` | {first_sentence(value)} |")
            entries.append(f".. auto{kind}:: {name}")
            if kind == "class":
                entries.append("   :show-inheritance:")
                if "members-of-bases-only" not in self.options or name.count(".") > 1:
                    entries.append("   :members:")
            entries.append("")
        return self.parse_text_to_nodes("\n".join([*table, "", "```{eval-rst}", *entries, "```"]))


def looked_up(name: str):
    """The object of a full name."""
    value = pymc_features
    for part in name.split(".")[1:]:
        value = getattr(value, part)
    return value


def kind_of(value) -> str:
    """What autodoc calls an object."""
    if not inspect.isclass(value):
        return "function"
    return "exception" if issubclass(value, BaseException) else "class"


def complain(app, env):
    """Every public name must have a page."""
    shown = {part for data in env.metadata.values() for part in data.get("public", "").split()}
    for name, part in public_names().items():
        if part not in shown:
            LOGGER.warning("%s has no page: add `%s` to a `public` directive in docs/reference", name, part)


def setup(app):
    """Called by Sphinx."""
    app.add_directive("public", Public)
    app.connect("env-check-consistency", complain)
    return {"parallel_read_safe": True}
