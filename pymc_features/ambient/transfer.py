"""Transfer functions of modes."""

import numpy as np


def transfer_functions(natural, ratios, frequencies) -> np.ndarray:
    """h (k, m) from unit modal forces to accelerations, for k frequencies [Hz] of the forces, all above zero.

    h_kr = 1 / (1 - beta^2 - 2 i zeta_r beta) with beta = f_r / f_k: that of `AmbientResponse` with q = 0.
    """
    beta = natural / np.asarray(frequencies)[:, None]
    return 1.0 / (1.0 - beta**2 - 2j * ratios * beta)
