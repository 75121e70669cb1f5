"""A simulator's fingerprint: equal only where the results must be equal, so that a cache can be trusted."""

import functools
import hashlib
import inspect
import pickle
import types

import cloudpickle
import numpy as np

PLAIN = str | bytes | int | float | complex | bool | None


class UnknownIdentityError(TypeError):
    """An object whose contents cannot be told."""


def fingerprint(*things) -> str:
    """SHA-256 of functions, arrays, objects and plain values.

    Of a function count its code, defaults and closure, and what it reaches by global names of its own module;
    functions of other modules count by name, modules by name and version, objects by their class's source and
    their attributes.

    Raises
    ------
    UnknownIdentityError
        For what can be neither taken apart nor pickled.
    """
    digest = hashlib.sha256()
    home = next((f.__module__ for f in map(innermost, things) if isinstance(f, types.FunctionType)), None)
    for thing in things:
        feed(digest, thing, home, frozenset())
    return digest.hexdigest()


def innermost(thing):
    """The function inside partial applications and bound methods."""
    while True:
        if isinstance(thing, functools.partial):
            thing = thing.func
        elif isinstance(thing, types.MethodType):
            thing = thing.__func__
        else:
            return thing


def feed(digest, thing, home, above):
    """Add one thing, with its type, to the digest; `above` are the objects it is inside of."""
    digest.update(type(thing).__qualname__.encode() + b"\0")
    if isinstance(thing, PLAIN):
        digest.update(repr(thing).encode() + b"\0")
    elif id(thing) not in above:
        parts = parts_of(thing, home)
        digest.update(b"%d\0" % len(parts))
        for part in parts:
            feed(digest, part, home, above | {id(thing)})


def parts_of(thing, home) -> list:
    """What a thing consists of."""
    if isinstance(thing, np.ndarray) and thing.dtype != object:
        return [str(thing.dtype), str(thing.shape), np.ascontiguousarray(thing).tobytes()]
    if isinstance(thing, functools.partial):
        return [thing.func, thing.args, thing.keywords]
    if isinstance(thing, types.FunctionType):
        if thing.__module__ != home:
            return [thing.__module__, thing.__qualname__]
        return [thing.__code__, thing.__defaults__, thing.__kwdefaults__, *reached(thing)]
    if isinstance(thing, types.MethodType):
        return [thing.__func__, thing.__self__]
    if isinstance(thing, types.CodeType):
        return [thing.co_code, thing.co_consts, thing.co_names, thing.co_name]
    if isinstance(thing, types.ModuleType):
        return [thing.__name__, str(getattr(thing, "__version__", ""))]
    if isinstance(thing, dict):
        return [part for key in sorted(thing, key=repr) for part in (key, thing[key])]
    if isinstance(thing, set | frozenset):
        return sorted(thing, key=repr)
    if isinstance(thing, list | tuple):
        return list(thing)
    if isinstance(thing, type):
        return [thing.__module__, thing.__qualname__, source(thing)]
    if hasattr(thing, "__dict__") and type(thing).__module__ != "builtins":
        return [type(thing), vars(thing)]
    return [pickled(thing)]


def reached(function) -> list:
    """Values in a function's closure, and of the global names in its code."""
    cells = []
    for cell in function.__closure__ or ():
        try:
            cells.append(cell.cell_contents)
        except ValueError:  # not yet assigned
            cells.append(None)
    names = sorted(set(names_in(function.__code__)) & set(function.__globals__))
    return [*cells, *(function.__globals__[name] for name in names)]


def names_in(code):
    """Names in a code object and in those nested in it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from names_in(constant)


def source(kind) -> str:
    """Source text of a class, where there is one."""
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):
        return ""


def pickled(thing) -> bytes:
    """A thing as bytes."""
    for dumps in (pickle.dumps, cloudpickle.dumps):
        try:
            return dumps(thing, protocol=5)
        except Exception:  # objects refuse in many ways
            continue
    raise UnknownIdentityError(f"{type(thing).__name__} can be neither taken apart nor pickled")
