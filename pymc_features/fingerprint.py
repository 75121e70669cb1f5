"""A simulator's fingerprint: equal only where the results must be equal, so that a cache can be trusted."""

import functools
import hashlib
import sys
import sysconfig
import types
from pathlib import Path

import numpy as np

from pymc_features.exceptions import UnknownIdentityError

PLAIN = str | bytes | int | float | complex | bool | None
INSTALLED = tuple(Path(p) for name, p in sysconfig.get_paths().items() if name.endswith(("stdlib", "lib")))


def fingerprint(*things) -> str:
    """SHA-256 of functions, arrays, objects and plain values.

    Of functions and classes count their code and what they reach by the names in it; of those of installed
    packages the name and what they hold. Modules count by name and version, objects by what pickle would
    keep of them.

    Raises
    ------
    UnknownIdentityError
        For what holds a lock, an open file or the like.
    """
    try:
        return Hasher().digest(things).hex()
    except RecursionError:
        raise UnknownIdentityError("something is nested too deeply") from None


class Hasher:
    """Digests of things; each is read once, however often it is met."""

    def __init__(self):
        self.known: dict[int, tuple[object, bytes]] = {}
        self.inside: list[int] = []  # what is being read

    def digest(self, thing) -> bytes:
        """SHA-256 of a thing, with its type."""
        digest = hashlib.sha256(type(thing).__qualname__.encode() + b"\0")
        if isinstance(thing, PLAIN):
            digest.update(thing if type(thing) is bytes else repr(thing).encode())
            return digest.digest()
        if id(thing) in self.known:
            return self.known[id(thing)][1]
        if id(thing) in self.inside:  # of itself
            return b"above %d" % (len(self.inside) - self.inside.index(id(thing)))
        self.inside.append(id(thing))
        parts = [self.digest(part) for part in parts_of(thing)]
        self.inside.pop()
        if isinstance(thing, set | frozenset):
            parts.sort()
        for part in parts:
            digest.update(part)
        self.known[id(thing)] = thing, digest.digest()  # which keeps it, and so its id
        return digest.digest()


def parts_of(thing) -> list:
    """What a thing consists of."""
    if type(thing) is np.ndarray and not thing.dtype.hasobject:
        return [str(thing.dtype), thing.shape, thing.tobytes()]
    if isinstance(thing, dict):
        return [part for item in thing.items() for part in item]
    if isinstance(thing, list | tuple | set | frozenset):
        return list(thing)
    if isinstance(thing, types.ModuleType):
        return [thing.__name__, str(getattr(thing, "__version__", ""))]
    if isinstance(thing, types.CodeType):
        return [thing.co_code, thing.co_consts, thing.co_names, thing.co_exceptiontable]
    if isinstance(thing, types.FunctionType):
        return parts_of_function(thing)
    if isinstance(thing, type):
        return parts_of_class(thing)
    if isinstance(thing, types.MethodType):
        return [thing.__func__, thing.__self__]
    if isinstance(thing, staticmethod | classmethod):
        return [thing.__func__]
    if isinstance(thing, property):
        return [thing.fget, thing.fset]
    if isinstance(thing, functools.partial):
        return [thing.func, thing.args, thing.keywords]
    if (inner := wrapped(thing)) is not None:
        return [inner]
    return parts_by_pickle(thing)


def parts_of_function(function) -> list:
    """Its code, and the values in its closure and of the global names in its code."""
    held = [function.__defaults__, function.__kwdefaults__]
    for cell in function.__closure__ or ():
        try:
            held.append(cell.cell_contents)
        except ValueError:  # not yet assigned
            held.append(None)
    if is_installed(function.__module__):
        return [function.__module__, function.__qualname__, *held]
    known = function.__globals__
    names = sorted({name for name in names_in(function.__code__) if name in known})
    return [function.__code__, *held, *((name, known[name]) for name in names)]


def names_in(code):
    """Names in a code object and in those nested in it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from names_in(constant)


def parts_of_class(kind) -> list:
    """Its methods, and what else is written in its body."""
    if is_installed(kind.__module__):
        return [kind.__module__, kind.__qualname__]
    methods = types.FunctionType | staticmethod | classmethod | property
    body = [
        (name, value)
        for name, value in vars(kind).items()
        if isinstance(value, methods) or not (name.startswith("__") or name == "_abc_impl")
    ]
    return [kind.__qualname__, kind.__bases__, *body]


def wrapped(thing):
    """The Python function inside a compiled or cached one."""
    held = getattr(thing, "__dict__", None)
    if not (callable(thing) and isinstance(held, dict) and is_installed(type(thing).__module__)):
        return None
    return held.get("py_func", held.get("__wrapped__"))


def parts_by_pickle(thing) -> list:
    """What pickle needs to make it again."""
    try:
        value = thing.__reduce_ex__(4)
    except Exception:  # objects refuse in many ways
        raise UnknownIdentityError(f"the contents of a {type(thing).__name__} cannot be told") from None
    if isinstance(value, str):
        return [getattr(thing, "__module__", ""), value]
    function, arguments, state, items, pairs = (*value, None, None, None)[:5]
    return [function, arguments, state, list(items or ()), list(pairs or ())]


@functools.cache
def is_installed(name) -> bool:
    """Whether a module is of Python's library, of an installed package or of this one."""
    if name is None or name.partition(".")[0] == __name__.partition(".")[0]:
        return name is not None
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return name in sys.builtin_module_names
    return any(path in Path(file).parents for path in INSTALLED)
