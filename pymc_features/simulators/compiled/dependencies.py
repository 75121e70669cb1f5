"""Hashes of the source that the machine code of a kernel depends on.

A module depends on every module of this package that it imports, directly or through others. A module that
defines `register` dispatches on types that its neighbours make known to it (the laws of nonlinear springs):
it depends on those neighbours as well. By regular expressions: parsing would take longer than the import.
"""

import hashlib
import re
from functools import cache
from pathlib import Path

PACKAGE = __name__.partition(".")[0]
ROOT = Path(__file__).parents[2]
IMPORT = re.compile(rf"^\s*from ({PACKAGE}[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)


def module_path(module: str) -> Path | None:
    """Source file of a module of this package; None for anything else."""
    path = ROOT.joinpath(*module.split(".")[1:])
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


@cache
def read(path: Path) -> str:
    """Source of a file."""
    return path.read_text(encoding="utf-8")


@cache
def neighbours(path: Path) -> frozenset[Path]:
    """Files of this package that a file imports, and those that register something with it."""
    found = set()
    for module, names in IMPORT.findall(read(path)):
        found |= {
            module_path(module),
            *(module_path(f"{module}.{name}") for name in re.findall(r"\w+", names)),
        }
    if re.search(r"^def register\(", read(path), re.MULTILINE):
        others = path.parent.rglob("*.py")
        found |= {other for other in others if re.search(r"^register\(", read(other), re.MULTILINE)}
    return frozenset(found - {None})


def dependencies(path: Path) -> set[Path]:
    """A file, and all files of this package on which its compiled functions depend."""
    found, waiting = set(), {path}
    while waiting:
        here = waiting.pop()
        found.add(here)
        waiting |= neighbours(here) - found
    return found


@cache
def source_hash(module: str) -> str:
    """SHA-256 (hexadecimal) of everything that can change the machine code of a module's functions."""
    digest = hashlib.sha256()
    for path in sorted(dependencies(module_path(module))):
        digest.update(f"{path.relative_to(ROOT)}\n{read(path)}".encode())
    return digest.hexdigest()
