"""The polynomials of a triangular map: which monomials, and their values for all axes at once."""

from typing import NamedTuple

import numpy as np

LINEAR, SQUARES, PRODUCTS, POWERS = "linear", "squares", "products", "powers"  # kinds
CLIP = 4.0  # standard deviations beyond which polynomials stay as they are
MAX_LOG_SCALE = 6.0
TERMS_PER_POINT = 0.25  # a polynomial has at most this many coefficients for each effective point


def monomials(t, kind: str):
    """Terms (n, terms) of a polynomial of coordinates (n, k), which count within `CLIP`.

    1 and t_i if it is `LINEAR`; besides, t_i^2 with `SQUARES`, all t_i t_j with `PRODUCTS`, and these and
    t_i^3, t_i^4 with `POWERS`: a parabola of parameters is none of the logarithms or logits that are sampled.
    """
    t = np.clip(t, -CLIP, CLIP)
    columns = [np.ones((len(t), 1)), t]
    if kind == SQUARES:
        columns.append(t**2)
    elif kind != LINEAR:
        i, j = np.triu_indices(t.shape[1])
        columns.append(t[:, i] * t[:, j])
    if kind == POWERS:
        columns += [t**3, t**4]
    return np.hstack(columns)


def affordable(k: int, n_points: float, powers: bool = True) -> str:
    """Polynomial of k coordinates with as many terms as so many effective points can tell.

    No `POWERS` unless these are wanted.
    """
    n_products = (k + 1) * (k + 2) // 2
    for kind, n_terms in ((POWERS, n_products + 2 * k), (PRODUCTS, n_products), (SQUARES, 2 * k + 1)):
        if n_terms <= TERMS_PER_POINT * n_points and (powers or kind != POWERS):
            return kind
    return LINEAR


class Axis(NamedTuple):
    """Coefficients of one axis: those of its place (of a kind) and log scale, and a constant."""

    kind: str
    shift: np.ndarray
    slope: np.ndarray
    level: float


class Polynomials:
    """The polynomials of all axes of a map, as two matrices of coefficients.

    Points come as columns, a few hundred at a time, so that their monomials stay in a processor's cache. What
    the first k axes give comes before what the others add.

    Parameters
    ----------
    axes : list of Axis
    """

    def __init__(self, axes):
        kinds = [axis.kind for axis in axes]
        self.products = PRODUCTS in kinds or POWERS in kinds
        self.powers = POWERS in kinds
        d = len(axes)
        size = [(k + 1 if self.products else 1) + 1 + 2 * self.powers for k in range(d)]
        self.ends = 1 + np.cumsum(size)
        self.shift, self.slope = np.zeros((2, d, self.ends[-1]))
        for k, axis in enumerate(axes):
            self.shift[k, self.places(k, axis.kind)] = axis.shift
            self.slope[k, self.places(k, SQUARES)] = axis.slope
        self.levels = np.array([axis.level for axis in axes])

    def places(self, k: int, kind: str) -> list[int]:
        """Rows of the monomials of the first k axes, in the order of `monomials`."""
        firsts = [1, *self.ends]
        linear = [firsts[i] for i in range(k)]
        squares = [firsts[i] + 1 + (i if self.products else 0) for i in range(k)]
        if kind == LINEAR:
            return [0, *linear]
        if kind == SQUARES:
            return [0, *linear, *squares]
        places = [0, *linear, *(firsts[j] + 1 + i for i in range(k) for j in range(i, k))]
        if kind == POWERS:
            places += [row + 1 for row in squares] + [row + 2 for row in squares]
        return places

    def begin(self, n: int) -> np.ndarray:
        """Room for the monomials (rows, n) of n points."""
        rows = np.empty((self.ends[-1], n))
        rows[0] = 1.0
        return rows

    def add(self, rows, t, k: int) -> None:
        """Put in what axis k adds to the axes before it, from clipped coordinates (d, n)."""
        first = 1 if k == 0 else self.ends[k - 1]
        rows[first] = t[k]
        last = first + 1 + (k if self.products else 0)
        np.multiply(t[k if not self.products else 0 : k + 1], t[k], out=rows[first + 1 : last + 1])
        if self.powers:
            np.multiply(rows[last], t[k], out=rows[last + 1])
            np.multiply(rows[last], rows[last], out=rows[last + 2])

    def of_all(self, t):
        """Places and log scales, each (d, n), at points (d, n)."""
        clipped, rows = np.clip(t, -CLIP, CLIP), self.begin(t.shape[1])
        for k in range(len(t)):
            self.add(rows, clipped, k)
        log_scale = np.clip(self.slope @ rows, -MAX_LOG_SCALE, MAX_LOG_SCALE)
        return self.shift @ rows, log_scale + self.levels[:, None]

    def solved(self, z):
        """The points (d, n) that have these coordinates z (d, n)."""
        t, clipped, rows = np.empty_like(z), np.empty_like(z), self.begin(z.shape[1])
        for k, end in enumerate((1, *self.ends[:-1])):
            slope, shift = self.slope[k, :end] @ rows[:end], self.shift[k, :end] @ rows[:end]
            log_scale = np.clip(slope, -MAX_LOG_SCALE, MAX_LOG_SCALE) + self.levels[k]
            t[k] = z[k] * np.exp(log_scale) + shift
            np.clip(t[k], -CLIP, CLIP, out=clipped[k])
            self.add(rows, clipped, k)
        return t
