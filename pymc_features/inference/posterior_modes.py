"""Modes of a posterior density on the unconstrained space, by its exact gradient."""

import numpy as np
from scipy.optimize import minimize

MAX_NEWTON = 30


class Density:
    """Log-posterior density of a model, Jacobians of its transforms included.

    Parameters
    ----------
    model : pymc.Model
    compile_kwargs : dict, optional
        For `pytensor.function`.
    """

    def __init__(self, model, compile_kwargs=None):
        self.function = model.logp_dlogp_function(ravel_inputs=True, **(compile_kwargs or {}))
        self.function.set_extra_values({})

    def __call__(self, x):
        """Return the log-density and its gradient (d,); -inf and zeros where it is not a number."""
        value, gradient = self.function(np.asarray(x, dtype=np.float64))
        value, gradient = float(value), np.array(gradient, dtype=np.float64)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return -np.inf, np.zeros_like(gradient)
        return value, gradient

    def negative(self, x):
        """What an optimiser wants: minus both."""
        value, gradient = self(x)
        return -value, -gradient

    def curvature(self, x, steps):
        """Minus the Hessian (d, d), by central differences of the gradient, fourth order in `steps` (d,)."""
        rows = []
        for i, h in enumerate(steps):
            move = np.zeros_like(x)
            move[i] = h
            near = (self(x + move)[1] - self(x - move)[1]) / (2.0 * h)
            far = (self(x + 2.0 * move)[1] - self(x - 2.0 * move)[1]) / (4.0 * h)
            rows.append((far - 4.0 * near) / 3.0)
        rows = np.array(rows)
        return 0.5 * (rows + rows.T)

    def scaled_curvature(self, x):
        """Curvature with steps that suit it: a fiftieth of each conditional standard deviation."""
        steps = 1e-5 * (1.0 + np.abs(x))
        for _ in range(2):
            diagonal = np.abs(np.diag(self.curvature(x, steps)))
            with np.errstate(divide="ignore"):
                steps = np.where(diagonal > 0.0, np.clip(0.02 / np.sqrt(diagonal), 1e-9, 0.1), steps)
        return self.curvature(x, steps)


def climb(density: Density, start: np.ndarray):
    """Climb from a start (d,) to a mode.

    Returns
    -------
    x, value, curvature
        The mode, its log-density, and minus the Hessian there; None if there is no maximum with a positive
        definite curvature.
    """
    x = minimize(density.negative, start, jac=True, method="L-BFGS-B", options={"maxiter": 500}).x
    value, gradient = density(x)
    for _ in range(MAX_NEWTON):
        curvature = density.scaled_curvature(x)
        if not np.isfinite(curvature).all():
            return None
        eigenvalues, vectors = np.linalg.eigh(curvature)
        turned = vectors.T @ gradient
        step = vectors @ (turned / np.maximum(np.abs(eigenvalues), 1e-12 * np.abs(eigenvalues).max()))
        gain = float(gradient @ step)
        if gain < 1e-12 and eigenvalues[0] > 0.0:
            return x, value, curvature
        for _ in range(30):
            new_value, new_gradient = density(x + step)
            if new_value > value or gain < 1e-8:
                break
            step = 0.5 * step
        else:
            break
        x, value, gradient = x + step, new_value, new_gradient
    # rounding may keep the last gain from falling any further
    positive = np.isfinite(value) and np.linalg.eigvalsh(curvature)[0] > 0.0
    return (x, value, curvature) if positive and gain < 1e-4 else None


def distinct(modes):
    """Modes (x, value, curvature) from the highest on, without those that were found before."""
    kept = []
    for mode in sorted(modes, key=lambda m: -m[1]):
        x, _, curvature = mode
        if all((x - other) @ curvature @ (x - other) > 0.1 for other, _, _ in kept):
            kept.append(mode)
    return kept
