"""Rooms whose names are imported when they are asked for, so that a part of one is there without the rest."""

from collections.abc import Callable
from importlib import import_module


def lazily(room: str, places: dict[str, str]) -> tuple[Callable, Callable]:
    """`__getattr__` and `__dir__` of a room, of public names and the modules in it that define them."""

    def find(name: str):
        if name not in places:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        return getattr(import_module(f"{room}.{places[name]}"), name)

    return find, lambda: sorted(places)
