"""A user's gradient as a function of one array."""

import numpy as np


class FlatGradient:
    """Gradients by all parameters, one behind the other.

    Parameters
    ----------
    gradient : callable
        `gradient(*parameters, cotangent)`: one array for each parameter.
    """

    def __init__(self, gradient):
        self.gradient = gradient

    def __call__(self, *parameters_and_cotangent):
        *parameters, _ = parameters_and_cotangent
        results = self.gradient(*parameters_and_cotangent)
        if len(parameters) == 1 and np.shape(results) == np.shape(parameters[0]):
            results = [results]
        if [np.shape(r) for r in results] != [np.shape(p) for p in parameters]:
            raise ValueError(
                f"`gradient` must return arrays of the shapes {[np.shape(p) for p in parameters]}, got "
                f"{[np.shape(r) for r in results]}."
            )
        return np.concatenate([np.ravel(r) for r in results])
