"""M, C, K and the names of the degrees of freedom of a model in OpenSees, through its Python module.

OpenSees forms m M + c C + k K for coefficients of our choice (its integrator `GimmeMCK`), and the right-hand
side T' p of loads p at all nodes, of which T says how constrained nodes follow those that are retained
(`constraints Transformation`).
"""

from collections.abc import Callable
from contextlib import suppress
from inspect import signature
from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features._checks import check_choice, message
from pymc_features.structures.names import DofNames

DIRECTIONS = {  # by dimensions and degrees of freedom of a node
    (1, 1): ("x",),
    (2, 2): ("x", "y"),
    (2, 3): ("x", "y", "rz"),
    (3, 3): ("x", "y", "z"),
    (3, 6): ("x", "y", "z", "rx", "ry", "rz"),
}
#: With a stiffness of this share in it, a singular M or C can be factorised, which OpenSees does before it
#: gives the matrix. A power of two scales K without rounding: what is subtracted is what was added.
SHARE = 2.0**-200
MOST_DENSE = 300  # degrees of freedom, from which on sparse matrices cost less
TAG = 987654321  # of the pattern and time series that are added for a moment


class Layout(NamedTuple):
    """Names of the equations, of displacements that follow them, and of those that supports prevent."""

    own: tuple[str, ...]
    followers: dict[str, np.ndarray]
    held: tuple[str, ...]

    def names(self) -> DofNames:
        """The names as a structure takes them."""
        return DofNames({name: i for i, name in enumerate(self.own)}, self.followers, self.held)

    def influence(self, direction: str) -> np.ndarray:
        """Displacements (n,) under a unit displacement of all supports in one direction."""
        known = sorted({name.partition(":")[2] for name in self.own} & {"x", "y", "z"})
        check_choice(direction, "direction", known, "It is that of the ground motion.")
        influence = np.array([name.endswith(f":{direction}") for name in self.own], dtype=np.float64)
        for name, row in self.followers.items():
            if abs(row @ influence - name.endswith(f":{direction}")) > 1e-9:
                raise ValueError(
                    "`build` must tie nodes such that all of them can move with the ground, got a constraint "
                    f"on {name!r} that forbids it. Pass the matrices and `influence` to `from_matrices`."
                )
        return influence


class OpenSeesModel:
    """Called with parameters, a user's function builds the model anew, and its matrices are read.

    Parameters
    ----------
    build : callable
        Calls the commands of OpenSees that define nodes, masses, elements and constraints.
    """

    def __init__(self, build: Callable):
        self.build, self.layout, self.is_damped, self.ops = build, None, False, opensees()
        with suppress(TypeError, ValueError):  # of some built-in functions it is not known
            self.__signature__ = signature(build)

    def __call__(self, **values: float) -> tuple:
        """M, C and K (n, n) of the model as `build` leaves it; large ones are sparse."""
        ops = self.ops
        ops.wipe()
        try:
            self.build(**values)
            if not ops.getNodeTags():
                raise ValueError(message("build", "a function that makes a model in OpenSees", "no nodes"))
            prepare(ops)
            stiffness = left_hand_side(ops, 0.0, 0.0, 1.0)
            mass = left_hand_side(ops, 1.0, 0.0, SHARE) - SHARE * stiffness
            damping = left_hand_side(ops, 0.0, 1.0, SHARE) - SHARE * stiffness
            if self.layout is None:
                self.layout = layout(ops, len(stiffness))
                check_held(self.layout.own, mass, stiffness)
            self.is_damped |= bool(damping.any())
        finally:
            ops.wipe()
        if len(stiffness) > MOST_DENSE:
            return tuple(sparse.csc_array(a) for a in (mass, damping, stiffness))
        return mass, damping, stiffness


def opensees():
    """The module, which is no dependency."""
    try:
        from openseespy import opensees as ops
    except ImportError as error:
        raise ImportError(
            "`from_opensees` needs OpenSeesPy, which is not free for every use. Install it: "
            f"python -m pip install openseespy. ({error})"
        ) from error
    return ops


def prepare(ops) -> None:
    """An analysis whose equations are those of all nodes that are free."""
    ops.wipeAnalysis()
    ops.constraints("Transformation")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.algorithm("Linear")


def left_hand_side(ops, m: float, c: float, k: float) -> np.ndarray:
    """m M + c C + k K, array (n, n)."""
    ops.integrator("GimmeMCK", m, c, k)
    ops.analysis("Transient")
    ops.analyze(1, 0.0)  # forms it; where it is singular the step fails, and it is there nevertheless
    entries, n = np.array(ops.printA("-ret") or []), ops.systemSize()
    if not n or entries.size != n * n:
        what = "a function that leaves a model with free nodes"
        raise ValueError(message("build", what, f"{entries.size} entries of {n} equations"))
    return entries.reshape(n, n)


def check_held(names, mass, stiffness) -> None:
    """Refuse displacements that nothing holds, such as those of a master node out of its floor."""
    loose = ~(mass.any(axis=1) | stiffness.any(axis=1))
    if loose.any():
        free = ", ".join(name for name, is_loose in zip(names, loose, strict=True) if is_loose)
        what = "a function that gives each displacement mass or stiffness"
        raise ValueError(message("build", what, f"neither at {free}", "Hold them by `fix`."))


def layout(ops, n: int) -> Layout:
    """Names of all displacements of all nodes, by the equations that OpenSees gives them."""
    own, followers, held = [f"equation {i}" for i in range(n)], {}, []
    tied = list(ops.getConstrainedNodes() or [])
    for node in ops.getNodeTags():
        names = displacements(ops, node)
        if node not in tied:
            for name, equation in zip(names, ops.nodeDOFs(node), strict=True):
                if equation < 0:
                    held.append(name)
                else:
                    own[equation] = name
    ops.timeSeries("Constant", TAG)
    ops.integrator("GimmeMCK", 0.0, 0.0, 1.0)
    ops.algorithm("Linear", "-factorOnce")
    ops.analysis("Transient")
    at_rest = right_hand_side(ops, None, [])
    for node in tied:
        names, constrained = displacements(ops, node), set(ops.getConstrainedDOFs(node))
        for i, name in enumerate(names):
            unit = [float(i == j) for j in range(len(names))]
            row = right_hand_side(ops, node, unit) - at_rest
            if not row.any():
                held.append(name)
            elif i + 1 in constrained:
                followers[name] = row
            else:
                own[int(np.flatnonzero(row)[0])] = name
    return Layout(tuple(own), followers, tuple(held))


def right_hand_side(ops, node: int | None, load: list[float]) -> np.ndarray:
    """T' p (n,) of a load p at one node, besides what is there at rest."""
    ops.pattern("Plain", TAG, TAG)
    if node is not None:
        ops.load(node, *load)
    ops.analyze(1, 0.0)
    found = np.array(ops.printB("-ret"))
    ops.remove("loadPattern", TAG)
    return found


def displacements(ops, node: int) -> list[str]:
    """Names "node:direction" of the displacements and rotations of a node, or "node:1", "node:2", ..."""
    ndm, ndf = len(ops.nodeCoord(node)), int(np.ravel(ops.getNDF(node))[0])
    numbered = tuple(str(i + 1) for i in range(ndf))
    return [f"{node}:{direction}" for direction in DIRECTIONS.get((ndm, ndf), numbered)]
