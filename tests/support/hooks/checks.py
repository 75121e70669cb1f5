"""The checks of the private hooks, by the name of each; and what several of them need."""

import ast
import inspect
import textwrap

from pytensor.compile.mode import Mode

CHECKS = {}
INTERPRETED = Mode(linker="py", optimizer=None)


def check(*names):
    """Keep a function as the check of these hooks."""

    def keep(function):
        CHECKS.update(dict.fromkeys(names, function))
        return function

    return keep


def attributes_read(code) -> set[str]:
    """What a method, or the methods of a class, read of their object."""
    nodes = ast.walk(ast.parse(textwrap.dedent(inspect.getsource(code))))
    return {
        node.attr for node in nodes if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "self"
    }
