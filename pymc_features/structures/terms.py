"""Terms of affine structures: of functions that assemble matrices, of models in OpenSees, of exported files.

OpenSees forms m M + c C + k K for coefficients of our choice (its integrator `GimmeMCK`), and the right-hand
side T' p of loads p at all nodes, of which T says how constrained nodes follow those that are retained
(`constraints Transformation`).
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from inspect import signature
from itertools import combinations
from os import PathLike
from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features._checks import (
    as_array,
    as_list,
    check_callable,
    check_file,
    check_mapping,
    check_number,
    listed,
    message,
    shown,
    warn_caller,
)
from pymc_features.io import read_matrices
from pymc_features.io.reading.labels import system_of_units
from pymc_features.structures.linear import DofNames
from pymc_features.structures.matrices import UNITS, in_words

ROUNDING = 1e-12  # share of an entry that counts as rounding of it
AFFINE = 1e-9  # share of an entry by which it may miss the affine sum
FLOOR = 1e-12  # the same, on the scale of the diagonal: entries may be differences of large numbers
SPREAD = 0.5  # largest relative change of the parameters at the point of the check
THIRD = 1.4  # factor on a parameter that is looked at by itself
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
#: What programs call the matrices of a structure, in lower case.
NAMES = {
    "mass": ("m", "mass", "maa", "maax", "mgg", "mxx"),
    "stiffness": ("k", "stiffness", "stiff", "kaa", "kaax", "kgg", "kxx"),
    "damping": ("c", "damping", "baa", "baax", "bgg"),
}
HELD = 1e30  # of a diagonal entry: what programs hold a support with
LINEAR = 1e-6  # of the largest change: what two exports may differ by


class Terms(NamedTuple):
    """A_0 and A_i of A(theta) = A_0 + sum_i theta_i A_i.

    Attributes
    ----------
    nominal : dict of str to float
        Parameters in their order.
    constants : dict of str to array or csc_array
        A_0 of "mass", "damping" (if there is any) and "stiffness".
    terms : dict of str to list of p matrices or None
        A_i; None where parameter i does not act.
    labels : list of str or None
        Names of the degrees of freedom, where files have any.
    """

    nominal: dict[str, float]
    constants: dict
    terms: dict[str, list]
    labels: list[str] | None = None


# ---- of functions ----


def assembled_terms(build: Callable, parameters: Mapping[str, float], with_damping: bool) -> Terms:
    """Terms of (M, C, K) or (M, K), which `build` returns for parameters by name: each is doubled once.

    Refused are matrices that are not affine, by the names of the parameters, and one that changes nothing.
    """
    check_callable(build, "build", "Pass a function that returns (M, C, K) of parameters by name.")
    nominal = check_parameters(parameters)
    check_signature(build, nominal)
    first = assembled(build, nominal, with_damping)
    n = first["mass"].shape[0]

    def blocks(matrices):
        """M, C and K as the blocks of one diagonal."""
        if {a.shape[0] for a in matrices.values()} != {n}:
            got = ", ".join(f"{kind} {a.shape}" for kind, a in matrices.items())
            advice = "Parameters change entries, not the degrees of freedom."
            raise ValueError(message("build", "a function that returns matrices of one size", got, advice))
        return sparse.block_diag([sparse.coo_array(a) for a in matrices.values()], format="csr")

    def split(whole):
        places = {kind: slice(k * n, (k + 1) * n) for k, kind in enumerate(first)}
        found = {kind: whole[at, at] for kind, at in places.items()}
        return found if sparse.issparse(first["stiffness"]) else {k: a.toarray() for k, a in found.items()}

    def at(point):
        return blocks(assembled(build, point, with_damping))

    base, changes = blocks(first), []
    for name, value in nominal.items():
        step = value or 1.0
        moved = at(nominal | {name: value + step})
        changes.append(without_rounding(moved - base, abs(moved) + abs(base)) / step)
        if not changes[-1].nnz:
            raise ValueError(
                f"`parameters` must change a matrix each, got {name!r} that changes none. Use it in `build`, "
                "or leave it out."
            )
    parts = scaled(nominal, changes)
    constant = without_rounding(base - sum(parts), abs(base) + sum(map(abs, parts)))
    check_affine(at, nominal, [constant, *changes], list(first))
    parts = [split(change) for change in changes]
    terms = {kind: [a[kind] if abs(a[kind]).max() > 0.0 else None for a in parts] for kind in first}
    return Terms(nominal, split(constant), terms)


def assembled(build: Callable, point: Mapping[str, float], with_damping: bool) -> dict:
    """The matrices that `build` returns, by kind, arrays or `csc_array`."""
    returned = build(**point)
    if not isinstance(returned, tuple | list) or len(returned) not in (2, 3):
        got = f"{len(returned)} of them" if isinstance(returned, tuple | list) else type(returned).__name__
        raise TypeError(message("build", "a function that returns (M, C, K) or (M, K)", got))
    kinds = ("mass", "damping", "stiffness") if len(returned) == 3 else ("mass", "stiffness")
    matrices = {kind: as_square(a, kind) for kind, a in zip(kinds, returned, strict=True)}
    return {kind: a for kind, a in matrices.items() if with_damping or kind != "damping"}


def scaled(point: Mapping[str, float], changes: Sequence) -> list:
    """theta_i A_i at a point."""
    return [x * a for x, a in zip(point.values(), changes, strict=True)]


def check_affine(at: Callable, nominal: dict, terms: Sequence, kinds: Sequence[str]) -> None:
    """Compare with the matrices at a point where all parameters differ; name those that do not fit."""
    constant, *changes = terms
    n = constant.shape[0] // len(kinds)

    def misses(point):
        """Entries (e, 2) that are not the affine sum, and their relative errors (e,)."""
        found, total = at(point), constant + sum(scaled(point, changes))
        error, size = abs(total - found), abs(found) + abs(total)
        root = sparse.diags_array(np.sqrt(size.diagonal()))
        rounding = root @ (error > 0).astype(np.float64) @ root
        places = np.transpose((error > AFFINE * size + FLOOR * rounding).nonzero())
        return places, np.array([2.0 * error[i, j] / size[i, j] for i, j in places])

    def is_missed(*names):
        """Whether the matrix in question is another where some parameters alone are moved."""
        moved = {name: THIRD * (nominal[name] or 0.5) for name in names}
        return bool((misses(nominal | moved)[0][:, 0] // n == block).any())

    factors = 1.0 + SPREAD * np.random.default_rng(0).uniform(-1.0, 1.0, len(nominal))
    places, errors = misses({k: (x or 1.0) * f for (k, x), f in zip(nominal.items(), factors, strict=True)})
    if not errors.size:
        return
    block, row = divmod(int(places[errors.argmax(), 0]), n)
    if alone := [name for name in nominal if is_missed(name)]:
        how = f"{in_words(alone)} {'enters' if len(alone) == 1 else 'enter'} otherwise"
    else:
        pairs = [pair for pair in combinations(nominal, 2) if is_missed(*pair)]
        how = f"{in_words(pairs[0] if pairs else list(nominal))} act on each other"
    advice = "Take as parameters what the matrices are proportional to (E I, not a height)"
    if kinds[block] == "damping":
        advice += ", pass `damping` (Rayleigh coefficients from frequencies are no sum)"
    raise ValueError(
        "`build` must return matrices that are sums A_0 + sum_i theta_i A_i of the parameters, got a "
        f"{kinds[block]} in which {how}: the sum misses the entry in row {row}, column "
        f"{places[errors.argmax(), 1] % n} by {errors.max():.2g} of it. {advice}, or run the model as it is "
        "by ExternalSimulator."
    )


def check_parameters(parameters) -> dict[str, float]:
    """Names and finite nominal values, at least one."""
    advice = "Pass for example {'E': 30e9}."
    values = check_mapping(parameters, "parameters", "a mapping of names to nominal values", advice)
    if not values:
        raise ValueError(message("parameters", "one or more", shown(parameters), advice))
    nominal = {name: check_number(x, f"parameters[{name!r}]", advice) for name, x in values.items()}
    for name, value in nominal.items():
        if not np.isfinite(value):
            raise ValueError(message(f"parameters[{name!r}]", "finite", value, advice))
    return nominal


def check_signature(build: Callable, names: Mapping) -> None:
    """Refuse a function that cannot be called with these names."""
    try:
        known = signature(build)
    except (TypeError, ValueError):  # of some built-in functions it is not known
        return
    try:
        known.bind(**dict.fromkeys(names))
    except TypeError as error:
        what = f"a function of {', '.join(names)}, as in `parameters`"
        raise TypeError(message("build", what, f"one of {known}", f"It has {error}.")) from None


def as_square(value, kind: str):
    """A finite square matrix, array or `csc_array`; a vector is a diagonal."""
    matrix = value if sparse.issparse(value) else as_array(value)
    got = None
    if matrix.dtype.kind not in "iuf":
        got = f"{type(value).__name__} as {kind}"
    elif matrix.ndim == 1 and matrix.size:
        matrix = np.diag(matrix)
    elif matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.shape[0]:
        got = f"shape {matrix.shape} for {kind}"
    matrix = sparse.csc_array(matrix, dtype=np.float64) if sparse.issparse(value) else matrix
    if got is None and not np.isfinite(matrix.data if sparse.issparse(value) else matrix).all():
        got = f"NaN or infinity in {kind}"
    if got is not None:
        what = "a function that returns finite square matrices"
        raise ValueError(message("build", what, got, f"Return {kind} in {UNITS[kind]}."))
    return matrix


def without_rounding(difference, size) -> sparse.csr_array:
    """A difference without the entries that are only rounding of what it is between."""
    entries = sparse.csr_array(difference.multiply(abs(difference) > ROUNDING * size))
    entries.eliminate_zeros()
    return entries


# ---- of models in OpenSees ----


class OpenSeesModel:
    """Called with parameters, a user's function builds the model anew, and its matrices are read.

    Parameters
    ----------
    build : callable
        Calls the commands of OpenSees that define nodes, masses, elements and constraints.
    """

    def __init__(self, build: Callable):
        self.build, self.names, self.ops = build, None, opensees()
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
            if self.names is None:
                self.names = names_of(ops, len(stiffness))
                check_held(self.names.dofs, mass, stiffness)
        finally:
            ops.wipe()
        kind = sparse.csc_array if len(stiffness) > MOST_DENSE else np.asarray
        return kind(mass), kind(damping), kind(stiffness)


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


def names_of(ops, n: int) -> DofNames:
    """Names of all displacements of all nodes, by the equations that OpenSees gives them."""
    dofs, followers, held = [f"equation {i}" for i in range(n)], {}, []
    tied = list(ops.getConstrainedNodes() or [])
    for node in ops.getNodeTags():
        names = displacements(ops, node)
        if node not in tied:
            for name, equation in zip(names, ops.nodeDOFs(node), strict=True):
                if equation < 0:
                    held.append(name)
                else:
                    dofs[equation] = name
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
                dofs[int(np.flatnonzero(row)[0])] = name
    return DofNames({name: i for i, name in enumerate(dofs)}, followers, held)


def right_hand_side(ops, node: int | None, load: list[float]) -> np.ndarray:
    """T' p (n,) of a load p at one node, besides what is there at rest."""
    ops.pattern("Plain", TAG, TAG)
    if node is not None:
        ops.load(node, *load)
    ops.analyze(1, 0.0)
    side = np.array(ops.printB("-ret"))
    ops.remove("loadPattern", TAG)
    return side


def displacements(ops, node: int) -> list[str]:
    """Names "node:direction" of the displacements and rotations of a node, or "node:1", "node:2", ..."""
    ndm, ndf = len(ops.nodeCoord(node)), int(np.ravel(ops.getNDF(node))[0])
    numbered = tuple(str(i + 1) for i in range(ndf))
    return [f"{node}:{direction}" for direction in DIRECTIONS.get((ndm, ndf), numbered)]


# ---- of exported files ----


def exported_terms(base, terms, units: str | None) -> Terms:
    """Terms of the matrices of `AffineStructure.from_files`, whose parameters are factors of properties."""
    force, length, mass = (1.0, 1.0, 1.0) if units is None else system_of_units(units)
    factors = {"mass": mass, "stiffness": force / length, "damping": force / length}
    whole, labels = read_parts(base, "base", factors)
    if missing := {"mass", "stiffness"} - set(whole):
        what = f"files with {' and '.join(sorted(missing))}"
        raise ValueError(message("base", what, ", ".join(whole) or "none", "Name them: {'mass': ...}."))
    if not isinstance(terms, Mapping) or not terms:
        raise TypeError(message("terms", "a mapping of parameters to (path, factor)", shown(terms)))
    changes = {str(name): change_of(str(name), source, whole, factors) for name, source in terms.items()}
    free = free_dofs(whole, labels)
    terms_of = {kind: [change.get(kind) for change in changes.values()] for kind in whole}
    constants = {
        kind: (matrix - sum(a for a in terms_of[kind] if a is not None))[free][:, free]
        for kind, matrix in whole.items()
    }
    terms_of = {
        kind: [None if a is None else a[free][:, free] for a in found] for kind, found in terms_of.items()
    }
    labels = None if labels is None else [labels[k] for k in free]
    return Terms(dict.fromkeys(changes, 1.0), constants, terms_of, labels)


def read_parts(source, name: str, factors: Mapping[str, float]) -> tuple[dict, list[str] | None]:
    """Matrices by kind, in SI units, and the degrees of freedom where files name them."""
    found, labels = {}, None
    for kind, entry in source.items() if isinstance(source, Mapping) else [(None, source)]:
        pair = [entry, None] if isinstance(entry, str | PathLike) else as_list(entry)
        if kind not in (None, *NAMES) or pair is None or len(pair) != 2:
            what = f"a path, or a mapping of {', '.join(NAMES)} to paths or (path, name)"
            raise TypeError(message(name, what, shown(source)))
        path = check_file(pair[0], name)
        matrices = read_matrices(path)
        is_alone = len(matrices) == 1
        for title, matrix in matrices.items():
            usual = next((one for one, names in NAMES.items() if title.lower() in names), None)
            part = kind or usual or ("stiffness" if name != "base" and is_alone else None)
            is_meant = is_alone or usual == part if pair[1] is None else title == pair[1]
            if part is not None and is_meant:
                found[part] = factors[part] * (np.diag(matrix) if matrix.ndim == 1 else matrix)
                labels = matrices.labels.get(title, labels)
                if matrix.ndim == 2 and matrix.shape[0] != matrix.shape[1]:
                    raise ValueError(message(name, f"a file with a square {part}", f"shape {matrix.shape}"))
        if kind is not None and kind not in found:
            got = f"{path.name} with {listed(list(matrices))}"
            raise ValueError(message(name, f"a file with the {kind}", got))
    return {kind: sparse.csr_array(a) if sparse.issparse(a) else a for kind, a in found.items()}, labels


def change_of(name: str, source, whole: dict, factors: Mapping[str, float]) -> dict:
    """Changes of the matrices per unit of a factor, by one export or by two that agree."""
    where, slopes = f"terms[{name!r}]", []
    for pair in [source] if isinstance(source, tuple) else as_list(source) or [None]:
        if as_list(pair) is None or len(pair) != 2:
            raise TypeError(message(where, "(path, factor), or several", shown(source)))
        entry, factor = pair[0], check_number(pair[1], where)
        changed = {kind: a for kind, a in read_parts(entry, where, factors)[0].items() if kind in whole}
        sizes = {matrix.shape[0] for matrix in [*changed.values(), *whole.values()]}
        if factor == 1.0 or not changed:
            raise ValueError(message(where, "an export of a factor other than 1", shown(pair)))
        if len(sizes) > 1:
            raise ValueError(message(where, "of the size of the base", listed(sorted(sizes))))
        slopes.append({kind: (a - whole[kind]) / (factor - 1.0) for kind, a in changed.items()})
    first, *others = slopes
    for other in others:
        for kind in first.keys() & other.keys():
            largest, off = abs(first[kind]).max(), abs(other[kind] - first[kind]).max()
            if off > LINEAR * largest:
                raise ValueError(
                    f"`{where}` must change the {kind} in proportion to its factor, two exports differ by "
                    f"{off / largest:.2g} of the change. Choose a property in which it is linear."
                )
    changes = {kind: change for kind, change in first.items() if abs(change).max() > 0.0}
    if not changes:
        raise ValueError(message(where, "an export that changes a matrix", "none"))
    return changes


def free_dofs(whole: dict, labels: list[str] | None) -> np.ndarray:
    """Degrees of freedom that have stiffness or mass and are free to move."""
    mass, stiffness = whole["mass"], whole["stiffness"]
    if mass.shape != stiffness.shape:
        raise ValueError(message("base", f"of {stiffness.shape[0]} degrees of freedom", mass.shape[0]))
    size = sum(np.asarray(abs(matrix).sum(axis=0)).ravel() for matrix in (mass, stiffness))
    empty, held = size == 0.0, stiffness.diagonal() >= HELD
    for left_out, what in ((empty, "without stiffness and mass"), (held & ~empty, "that are held")):
        if left_out.any():
            names = [labels[k] if labels else str(k) for k in np.flatnonzero(left_out)]
            warn_caller(f"{len(names)} degrees of freedom {what} are left out: {listed(names)}.")
    return np.flatnonzero(~(empty | held))
