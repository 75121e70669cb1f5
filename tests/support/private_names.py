"""The list of docs/private_hooks.md, and what the package in fact uses of that kind."""

import ast
import importlib
import inspect
import re
import textwrap
from pathlib import Path
from typing import NamedTuple

import pymc_features
from support.commands import ROOT

PACKAGE = ROOT / "pymc_features"
LIBRARIES = ("pymc", "pytensor", "numba", "llvmlite")
INTERNAL = (  # modules that a library keeps for itself, though their names have no underscore
    *("numba.core", "numba.misc", "pytensor.link", "pymc.backends", "pymc.initial_point", "pymc.logprob"),
    *("pymc.sampling.parallel", "pymc.smc.kernels", "pymc.step_methods"),
)
INTERNAL_ATTRIBUTES = {"maker", "tag"}  # of compiled functions and of variables
OF_PYTHON = {"_asdict", "_exit", "_fields", "_replace"}  # of named tuples and of `os`


class Hook(NamedTuple):
    """A row of the list."""

    name: str
    files: frozenset[str]
    why: str
    without: str

    @property
    def last(self) -> str:
        return self.name.rpartition(".")[2]


def listed_hooks() -> list[Hook]:
    """The rows of the page."""
    rows = re.findall(
        r"^\| `([\w.]+)` \| (.+?) \| (.+?) \| (.+?) \|$",
        (ROOT / "docs" / "private_hooks.md").read_text(),
        flags=re.MULTILINE,
    )
    return [
        Hook(name, frozenset(re.findall(r"`([^`]+)`", files)), why, without)
        for name, files, why, without in rows
    ]


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def is_library(module: str) -> bool:
    return module.partition(".")[0] in LIBRARIES


def private_imports(tree: ast.AST) -> set[str]:
    """What a file imports that a library keeps for itself."""
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and is_library(node.module):
            imported |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names if is_library(alias.name)}
    return {
        name
        for name in imported
        if any(map(is_private, name.split("."))) or any(f"{name}.".startswith(f"{m}.") for m in INTERNAL)
    }


def own_names(trees) -> set[str]:
    """Every name that the package defines or sets itself."""
    names = set(OF_PYTHON)
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
    return names


def private_attributes(tree: ast.AST, ours: set[str], listed: set[str]) -> set[str]:
    """Attributes of others with an underscore; and where the name of one on the list stands in quotes."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            others = is_private(node.attr) and node.attr not in ours
            if others or (node.attr in INTERNAL_ATTRIBUTES and node.attr not in ours):
                found.add(node.attr)
        elif isinstance(node, ast.Constant) and node.value in listed and is_private(node.value):
            found.add(node.value)
    return found


def inherited_names(kind: type) -> set[str]:
    """Private names in the body of a class of ours that a class of a library above it has as well."""
    above = [base for base in kind.__mro__ if is_library(base.__module__)]
    names = set()
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kind)))) if above else ():
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("self", "cls"):
            names.add(node.attr)
    return {
        name
        for name in filter(is_private, names)
        if any(hasattr(base, name) or re.search(rf"self\.{name}\b", source(base)) for base in above)
    }


def source(kind: type) -> str:
    """Source of a class of a library; empty for one that is not written in Python."""
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):
        return ""


def classes() -> list[type]:
    """Every class of the package that has a base; JAX, which starts threads, is not imported."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        if path.name != "jax_dispatch.py" and re.search(r"^class \w+\(", path.read_text(), re.MULTILINE):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            kinds = vars(importlib.import_module(name)).values()
            found += [kind for kind in kinds if inspect.isclass(kind) and kind.__module__ == name]
    return found


def used_hooks(folder: Path = PACKAGE, kinds: list[type] | None = None) -> set[tuple[str, str]]:
    """Pairs of a full name, or the last part of one, and the file that uses it."""
    trees = {path: ast.parse(path.read_text()) for path in folder.rglob("*.py")}
    ours = own_names(trees.values())
    listed = {hook.last for hook in listed_hooks()}
    found = set()
    for path, tree in trees.items():
        names = private_imports(tree) | private_attributes(tree, ours, listed)
        found |= {(name, path.relative_to(folder).as_posix()) for name in names}
    for kind in classes() if kinds is None else kinds:
        path = Path(inspect.getsourcefile(kind)).relative_to(Path(pymc_features.__file__).parent)
        found |= {(name, path.as_posix()) for name in inherited_names(kind)}
    return found
