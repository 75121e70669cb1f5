"""Several climbs at once to the modes of a density, and its curvature there."""

from collections.abc import Callable

import numpy as np

MEMORY = 10  # steps that the inverse Hessian is built from
MAX_ITERATIONS = 200
MAX_HALVINGS = 12
LONGEST = 2.0  # of the first step and, times the number of iterations, of others
SMALL_GAIN = 0.03  # in the log-density, over three iterations: a quarter of a standard deviation away
ARMIJO = 1e-4


def climb(
    density: Callable,
    starts: np.ndarray,
    arrived: Callable,
    small_gain: float = SMALL_GAIN,
    iterations: int = MAX_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Climb from all starts together: L-BFGS with backtracking.

    Nocedal & Wright, Numerical Optimization, 2006, section 7.2.

    Parameters
    ----------
    density : callable
        Log-density (n,) and its gradient (n, d) at points (n, d), of coordinates of about unit scale.
    starts : array (n, d)
    arrived : callable
        Whether points (n, d) are where no climb need go on, array (n,).
    small_gain : float
        In the log-density, over three iterations, at which a climb ends.
    iterations : int
        At most.

    Returns
    -------
    x, value : array (n, d) and (n,)
        Where each climb ended; one that starts where the density is zero stays.
    """
    x = starts.copy()
    value, slope = density(x)
    n, d = x.shape
    steps, changes, n_kept = np.zeros((n, MEMORY, d)), np.zeros((n, MEMORY, d)), np.zeros(n, dtype=int)
    going = value > -np.inf
    last = np.full((3, n), -np.inf)
    for iteration in range(iterations):
        rows = np.flatnonzero(going)
        if not len(rows):
            break
        direction = ascent_direction(slope[rows], steps[rows], changes[rows], n_kept[rows])
        longest = LONGEST * (1.0 + iteration)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        direction *= np.minimum(1.0, longest / np.maximum(length, 1e-300))
        y, new_value, new_slope = line_search(density, x[rows], value[rows], slope[rows], direction)
        s, c = y - x[rows], slope[rows] - new_slope
        useful = (s * c).sum(axis=1) > 1e-10 * np.linalg.norm(s, axis=1) * np.linalg.norm(c, axis=1)
        store(rows[useful], s[useful], c[useful], steps, changes, n_kept)
        n_kept[rows[~useful]] = 0  # from a straight or hollow stretch, begin anew with the gradient
        x[rows], value[rows], slope[rows] = y, new_value, new_slope
        going[rows] = (new_value - last[0, rows] > small_gain) & ~arrived(y)
        last[:, rows] = np.vstack([last[1:, rows], new_value[None]])
    return x, value


def ascent_direction(slope, steps, changes, n_kept):
    """Two-loop recursion for each row: inverse Hessian times gradient (n, d)."""
    q = slope.copy()
    n, memory, _ = steps.shape
    products = (steps * changes).sum(axis=2)
    used = np.arange(memory)[None] >= memory - n_kept[:, None]
    inverse = np.where(used, 1.0 / np.where(used, products, 1.0), 0.0)
    alphas = np.zeros((n, memory))
    for i in reversed(range(memory)):
        alphas[:, i] = inverse[:, i] * (steps[:, i] * q).sum(axis=1)
        q -= alphas[:, i, None] * changes[:, i]
    newest = changes[:, -1]
    scale = np.where(n_kept > 0, products[:, -1] / np.maximum((newest**2).sum(axis=1), 1e-300), 0.0)
    first = 1.0 / np.maximum(np.linalg.norm(slope, axis=1), 1.0)
    q *= np.where(n_kept > 0, scale, first)[:, None]
    for i in range(memory):
        beta = inverse[:, i] * (changes[:, i] * q).sum(axis=1)
        q += (alphas[:, i] - beta)[:, None] * steps[:, i]
    return q


def store(rows, s, c, steps, changes, n_kept):
    """Put the newest pair last."""
    for history, new in ((steps, s), (changes, c)):
        history[rows] = np.concatenate([history[rows, 1:], new[:, None]], axis=1)
    n_kept[rows] = np.minimum(n_kept[rows] + 1, steps.shape[1])


def line_search(density, x, value, slope, direction):
    """Halve each step until it gains enough; rows that find nothing stay."""
    gain = ARMIJO * (slope * direction).sum(axis=1)
    length = np.ones(len(x))
    best, best_value, best_slope = x.copy(), value.copy(), slope.copy()
    open_rows = np.arange(len(x))
    for _ in range(MAX_HALVINGS):
        y = x[open_rows] + length[open_rows, None] * direction[open_rows]
        new_value, new_slope = density(y)
        good = new_value >= value[open_rows] + length[open_rows] * gain[open_rows]
        found = open_rows[good]
        best[found], best_value[found], best_slope[found] = y[good], new_value[good], new_slope[good]
        open_rows = open_rows[~good]
        if not len(open_rows):
            break
        length[open_rows] *= 0.25
    return best, best_value, best_slope


def curvature(density: Callable, x: np.ndarray) -> np.ndarray:
    """Minus the Hessian (d, d) at a point (d,), by central differences of the gradient.

    The steps suit the density: a tenth of each conditional standard deviation, found with small ones.
    """
    steps = np.full(len(x), 1e-4)
    for _ in range(2):
        ends = np.concatenate([x + np.diag(steps), x - np.diag(steps)])
        slopes = density(ends)[1].reshape(2, len(x), len(x))
        hessian = (slopes[1] - slopes[0]) / (2.0 * steps[:, None])
        diagonal = np.diag(hessian)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.where(diagonal > 0.0, np.clip(0.1 / np.sqrt(diagonal), 1e-7, 0.1), 1e-3)
    return 0.5 * (hessian + hessian.T)
