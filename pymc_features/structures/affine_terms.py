"""The terms of M, C and K that are affine in parameters, from a function that assembles them."""

import inspect
from collections.abc import Callable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features._checks import as_array, check_callable, check_mapping, check_number, message, shown

UNITS = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
ROUNDING = 1e-12  # share of an entry that counts as rounding of it
AFFINE = 1e-9  # share of an entry by which it may miss the affine sum
FLOOR = 1e-12  # the same, on the scale of the diagonal: entries may be differences of large numbers
SPREAD = 0.5  # largest relative change of the parameters at the point of the check
THIRD = 1.4  # factor on a parameter that is looked at by itself


class AffineTerms(NamedTuple):
    """Parameters and the terms of each matrix.

    Attributes
    ----------
    nominal : dict of str to float
        Parameters in their order.
    constants : dict of str to array or csc_array
        A_0 of "mass", "damping" (if there is any) and "stiffness".
    terms : dict of str to list of p matrices or None
        A_i; None where parameter i does not act.
    """

    nominal: dict[str, float]
    constants: dict
    terms: dict


def affine_terms(build: Callable, parameters: Mapping[str, float], *, with_damping: bool) -> AffineTerms:
    """A_0 and A_i of A(theta) = A_0 + sum_i theta_i A_i, by a change of each parameter; checked at a point.

    Parameters
    ----------
    build : callable
        (M, C, K) or (M, K), arrays or sparse matrices, of parameters by name.
    parameters : mapping of str to float
        Nominal values; each is doubled once (zero: becomes 1).
    with_damping : bool
        Whether C is wanted.

    Raises
    ------
    ValueError
        If a matrix is not affine, by the names of the parameters, or a parameter changes nothing.
    """
    assemble, nominal = Assembly(build, with_damping), check_parameters(parameters)
    check_signature(build, nominal)
    base = assemble(nominal)
    constants, terms = dict(base), {kind: [] for kind in base}
    for name, value in nominal.items():
        step = value or 1.0
        moved = assemble(nominal | {name: value + step})
        for kind, matrix in base.items():
            change = without_rounding(moved[kind] - matrix, abs(moved[kind]) + abs(matrix))
            terms[kind].append(change / step if change.count_nonzero() else None)
        if all(parts[-1] is None for parts in terms.values()):
            raise ValueError(
                f"`parameters` must change a matrix each, got {name!r} that changes none. Use it in `build`, "
                "or leave it out."
            )
    for kind, matrix in base.items():
        parts = [x * a for x, a in zip(nominal.values(), terms[kind], strict=True) if a is not None]
        size = abs(matrix) + sum(map(abs, parts))
        constants[kind] = without_rounding(matrix - sum(parts), size)
    found = AffineTerms(nominal, constants, terms)
    check_affine(assemble, found)
    if assemble.is_sparse:
        return found
    dense = {k: [None if a is None else a.toarray() for a in parts] for k, parts in terms.items()}
    return AffineTerms(nominal, {kind: a.toarray() for kind, a in constants.items()}, dense)


def check_parameters(parameters) -> dict[str, float]:
    """Names and finite nominal values, at least one."""
    advice = "Pass for example {'E': 30e9}."
    given = check_mapping(parameters, "parameters", "a mapping of names to nominal values", advice)
    if not given:
        raise ValueError(message("parameters", "one or more", shown(parameters), advice))
    nominal = {name: check_number(x, f"parameters[{name!r}]", advice) for name, x in given.items()}
    for name, value in nominal.items():
        if not np.isfinite(value):
            raise ValueError(message(f"parameters[{name!r}]", "finite", value, advice))
    return nominal


def check_signature(build: Callable, names: Mapping) -> None:
    """Refuse a function that cannot be called with these names."""
    try:
        signature = inspect.signature(build)
    except (TypeError, ValueError):  # of some built-in functions it is not known
        return
    try:
        signature.bind(**dict.fromkeys(names))
    except TypeError as error:
        what = f"a function of {', '.join(names)}, as in `parameters`"
        raise TypeError(message("build", what, f"one of {signature}", f"It has {error}.")) from None


class Assembly:
    """The matrices that `build` returns, by kind, as `csc_array`; all of one size."""

    def __init__(self, build: Callable, with_damping: bool):
        advice = "Pass a function that returns (M, C, K) of parameters by name."
        self.build, self.with_damping = check_callable(build, "build", advice), with_damping
        self.is_sparse, self.first = False, None

    def __call__(self, values: Mapping[str, float]) -> dict:
        found = self.build(**values)
        if not isinstance(found, tuple | list) or len(found) not in (2, 3):
            got = f"{len(found)} of them" if isinstance(found, tuple | list) else type(found).__name__
            raise TypeError(message("build", "a function that returns (M, C, K) or (M, K)", got))
        kinds = ("mass", "damping", "stiffness") if len(found) == 3 else ("mass", "stiffness")
        self.is_sparse |= sparse.issparse(found[-1])
        matrices = {kind: as_sparse(a, kind) for kind, a in zip(kinds, found, strict=True)}
        shapes = {kind: a.shape for kind, a in matrices.items()}
        if self.first is None:
            self.first = shapes
        if self.first != shapes or len(set(shapes.values())) > 1:
            got = ", ".join(f"{kind} {shape}" for kind, shape in (self.first | shapes).items())
            advice = "Parameters change entries, not the degrees of freedom."
            raise ValueError(message("build", "a function that returns matrices of one size", got, advice))
        if not self.with_damping:
            matrices.pop("damping", None)
        return matrices


def as_sparse(value, kind) -> sparse.csc_array:
    """A finite square matrix; a vector is a diagonal."""
    array = value if sparse.issparse(value) else as_array(value)
    got = None
    if array.dtype.kind not in "iuf":
        got = f"{type(value).__name__} as {kind}"
    elif array.ndim == 1 and array.size:
        array = sparse.diags_array(np.asarray(array, dtype=np.float64))
    elif array.ndim != 2 or array.shape[0] != array.shape[1] or not array.shape[0]:
        got = f"shape {array.shape} for {kind}"
    if got is None:
        matrix = sparse.csc_array(array, dtype=np.float64)
        if np.isfinite(matrix.data).all():
            return matrix
        got = f"NaN or infinity in {kind}"
    what = "a function that returns finite square matrices"
    raise ValueError(message("build", what, got, f"Return {kind} in {UNITS[kind]}."))


def without_rounding(difference, size) -> sparse.csc_array:
    """A difference without the entries that are only rounding of what it is between."""
    kept = sparse.csc_array(difference.multiply(abs(difference) > ROUNDING * size))
    kept.eliminate_zeros()
    return kept


def check_affine(assemble: Assembly, found: AffineTerms) -> None:
    """Compare with the matrices at a point where all parameters differ; name those that do not fit."""
    rng = np.random.default_rng(0)
    factors = 1.0 + SPREAD * rng.uniform(-1.0, 1.0, len(found.nominal))
    point = {
        name: (value or 1.0) * x for (name, value), x in zip(found.nominal.items(), factors, strict=True)
    }
    wrong = misses(assemble, found, point)
    if not wrong:
        return
    kind, (size, row, column) = max(wrong.items(), key=lambda item: item[1][0])
    alone = [name for name in found.nominal if kind in misses(assemble, found, moved_by(found, name))]
    if alone:
        how = f"{named(alone)} {'enters' if len(alone) == 1 else 'enter'} otherwise"
    else:
        free = combinations(found.nominal, 2)
        pairs = [pair for pair in free if kind in misses(assemble, found, moved_by(found, *pair))]
        how = f"{named(pairs[0] if pairs else list(found.nominal))} act on each other"
    advice = "Take as parameters what the matrices are proportional to (E I, not a height)"
    if kind == "damping":
        advice += ", pass `damping` (Rayleigh coefficients from frequencies are no sum)"
    raise ValueError(
        "`build` must return matrices that are sums A_0 + sum_i theta_i A_i of the parameters, got a "
        f"{kind} in which {how}: the sum misses the entry in row {row}, column {column} by {size:.2g} of it. "
        f"{advice}, or run the model as it is by ExternalSimulator."
    )


def moved_by(found: AffineTerms, *names: str) -> dict[str, float]:
    """The nominal parameters, but for some."""
    return found.nominal | {name: THIRD * (found.nominal[name] or 0.5) for name in names}


def misses(assemble: Assembly, found: AffineTerms, point: Mapping[str, float]) -> dict:
    """The worst entry of each matrix that is not the affine sum: its relative error, row and column."""
    worst = {}
    for kind, matrix in assemble(point).items():
        parts = [x * a for x, a in zip(point.values(), found.terms[kind], strict=True) if a is not None]
        total = found.constants[kind] + sum(parts)
        error, size = abs(total - matrix), abs(matrix) + abs(total)
        root = sparse.diags_array(np.sqrt(size.diagonal()))
        rounding = root @ (error > 0).astype(np.float64) @ root
        rows, columns = (error > AFFINE * size + FLOOR * rounding).nonzero()
        if rows.size:
            shares = [2.0 * error[i, j] / size[i, j] for i, j in zip(rows, columns, strict=True)]
            at = int(np.argmax(shares))
            worst[kind] = float(shares[at]), int(rows[at]), int(columns[at])
    return worst


def named(names) -> str:
    """Names in words."""
    *rest, last = names
    return f"{', '.join(rest)} and {last}" if rest else last
