r"""A Gaussian process of several outputs that share one kernel, and what a further point would teach it.

Outputs y (point, output) have unknown means and the covariance B_jk k(x, x'): kriging with a constant trend,
and intrinsic coregionalisation. One Cholesky factor serves all outputs, their prediction does not depend on
B, and the covariance of the errors of a prediction is B v(x), v the variance for B = 1.
"""

import warnings

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular

FIT_POINTS = 200  # that the length scales are fitted to, whatever there are
BOUNDS = (1e-2, 1e3)  # of the length scales, over the spread of the points
NOISE_BOUNDS = (1e-9, 1e-3)  # over the variance of the outputs
SMOOTHNESS = 2.5  # Matern: twice differentiable


def unit_kernel(lengths: np.ndarray):
    """Matern kernel of variance one with these length scales (parameter,)."""
    from sklearn.gaussian_process.kernels import Matern

    return Matern(lengths, nu=SMOOTHNESS)


def fit_lengths(x: np.ndarray, y: np.ndarray, lengths: np.ndarray | None = None):
    """Length scales (parameter,) and noise, over the variance, of most likelihood.

    Parameters
    ----------
    x, y : array (point, parameter), (point, output)
    lengths : array (parameter,), optional
        Where to begin.
    """
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    x, y = x[:FIT_POINTS], y[:FIT_POINTS]
    spread = np.std(x, axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    start = np.ones(x.shape[1]) if lengths is None else np.clip(lengths / spread, *BOUNDS)
    kernel = ConstantKernel() * Matern(start, BOUNDS, nu=SMOOTHNESS) + WhiteKernel(1e-6, NOISE_BOUNDS)
    process = GaussianProcessRegressor(kernel, alpha=1e-10, normalize_y=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length scale at its bound is no harm
        fitted = process.fit(x / spread, y).kernel_
    return fitted.k1.k2.length_scale * spread, fitted.k2.noise_level / fitted.k1.k1.constant_value


class GaussianProcess:
    """The process that passes near given points.

    Parameters
    ----------
    x, y : array (point, parameter), (point, output)
    lengths : array (parameter,)
        Length scales of the kernel.
    noise : float
        Variance of y about the process, over that of the process.

    Raises
    ------
    LinAlgError
        If the points determine nothing.
    """

    def __init__(self, x, y, lengths, noise):
        self.x, self.kernel = x, unit_kernel(lengths)
        n = len(x)
        if n < 3 or not (np.isfinite(x).all() and np.isfinite(y).all() and noise >= 0):
            raise LinAlgError("three points at least, and finite numbers")
        self.factor = cholesky(self.kernel(x) + (noise + 1e-9) * np.eye(n), lower=True)
        ones = solve_triangular(self.factor, np.ones(n), lower=True)
        self.by_ones, self.information = ones, ones @ ones
        self.mean = ones @ solve_triangular(self.factor, y, lower=True) / self.information
        residual = y - self.mean
        self.weights = cho_solve((self.factor, True), residual)
        self.output_covariance = residual.T @ self.weights / (n - 1)

    def predict(self, x: np.ndarray) -> "Prediction":
        """The outputs at other points (point, parameter)."""
        return Prediction(self, x)


class Prediction:
    """Outputs at some points, and how uncertain they are together.

    Attributes
    ----------
    mean : array (point, output)
    variance : array (point,)
        Of an output with B_jj = 1.
    """

    def __init__(self, process: GaussianProcess, x: np.ndarray):
        self.x, self.kernel = x, process.kernel
        cross = self.kernel(process.x, x)
        self.mean = process.mean + cross.T @ process.weights
        self.known = solve_triangular(process.factor, cross, lower=True)
        self.trend = (1.0 - process.by_ones @ self.known) / np.sqrt(process.information)
        self.variance = np.maximum(1.0 - np.sum(self.known**2, axis=0) + self.trend**2, 0.0)
        self._learnt: list[np.ndarray] = []

    def learn(self, point: int) -> np.ndarray:
        """Variances (point,) once the outputs of this point are known, too: one step of a Cholesky factor."""
        column = self.kernel(self.x, self.x[point : point + 1])[:, 0]
        column += self.trend * self.trend[point] - self.known.T @ self.known[:, point]
        for row in self._learnt:
            column -= row * row[point]
        self._learnt.append(column / np.sqrt(max(column[point], 1e-12)))
        self.variance = np.maximum(self.variance - self._learnt[-1] ** 2, 0.0)
        return self.variance
