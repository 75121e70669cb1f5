"""The ten storeys of the source on springs that yield.

Masses, initial stiffness, damping and the springs that theta scales are those of `paper.chain`. With the
yield displacement below, the drifts of the first seven springs under El Centro 1940 NS at the true theta are
4.2, 3.6, 3.0, 3.1, 2.9, 2.1 and 1.4 times as large, and the upper three stay below it; linear springs would
drift 5.8 times as far at the base.
"""

import numpy as np
from pytensor.graph.basic import Variable

from pymc_features.structures import HystereticChain
from pymc_features.study import paper

YIELD_DISPLACEMENT = 0.005  # m, of every spring; the drift at which a spring of 1800 N/m yields, at 9 N
POST_YIELD_RATIO = 0.1
SHARPNESS = 2.0  # of the transition; with beta = gamma = 1/2 springs unload at the initial stiffness


def chain(theta: float | Variable = 1.0, *, stiffness: float = paper.STIFFNESS) -> HystereticChain:
    """Ten masses of 1 kg on Bouc-Wen springs, the first three of them scaled by `theta`.

    Parameters
    ----------
    theta : float or TensorVariable
        Factor of the initial stiffness, and so of the yield force, of springs 0 to 2 [-].
    stiffness : float
        Nominal initial stiffness [N/m]; the yield displacement stays.

    Examples
    --------
    >>> chain(1.2).stiffness[:4] * YIELD_DISPLACEMENT  # N, without hardening
    array([10.8, 10.8, 10.8,  9. ])
    """
    nominal = HystereticChain(
        np.full(paper.N_STOREYS, paper.MASS),
        stiffness,
        paper.DAMPING,
        yield_displacement=YIELD_DISPLACEMENT,
        post_yield_ratio=POST_YIELD_RATIO,
        sharpness=SHARPNESS,
    )
    return nominal.scale_stiffness(theta, springs=paper.UNCERTAIN_SPRINGS)
