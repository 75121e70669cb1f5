"""The structures of the study: the source's chain, and the same on springs that yield. Each is an entry."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pytensor.graph.basic import Variable

from pymc_features._checks import check_choice, check_number
from pymc_features.structures import HystereticChain, Structure
from pymc_features.study import paper
from pymc_features.study.exact import WITH_REFERENCE

DEFAULT = "linear"
QUICK = {"draws": 250, "chains": 2, "multipliers": (0.2, 1.0, 10.0)}
YIELD_DISPLACEMENT = 0.005  # m, of every spring; the drift at which a spring of 1800 N/m yields, at 9 N
POST_YIELD_RATIO = 0.1
SHARPNESS = 2.0  # of the transition; with beta = gamma = 1/2 springs unload at the initial stiffness


@dataclass(frozen=True)
class StudyStructure:
    """A structure of the study, and how much of its posteriors is sampled unless asked otherwise.

    Attributes
    ----------
    name : str
        By which it is asked for.
    title : str
        For figures and messages.
    chain : callable
        ``(theta, *, stiffness)`` -> structure; theta is a number or a random variable.
    likelihoods : tuple of str
        Those compared by default.
    draws, chains : int
        Of `sample`, and of `sample_smc` for ABC.
    quick_seconds : float, optional
        How much of a record after its peak is enough for a first look, where a response is costly [s].
    quick : dict
        Settings for a first look.
    stiffness : float
        Nominal (initial) spring stiffness [N/m], positive.
    """

    name: str
    title: str
    chain: Callable[..., Structure]
    likelihoods: tuple[str, ...]
    draws: int
    chains: int
    quick_seconds: float | None = None
    quick: dict = field(default_factory=lambda: dict(QUICK))
    stiffness: float = paper.STIFFNESS

    def at(self, theta: float | Variable = 1.0) -> Structure:
        """The structure with this factor, by default the true one."""
        return self.chain(theta, stiffness=self.stiffness)


def bouc_wen_chain(theta: float | Variable = 1.0, *, stiffness: float = paper.STIFFNESS) -> HystereticChain:
    """Ten masses of 1 kg on Bouc-Wen springs, the first three of them scaled by `theta`.

    Masses, initial stiffness, damping and the springs that theta scales are those of `paper.chain`. The
    drifts of the first seven springs under El Centro 1940 NS at the true theta are 4.2, 3.6, 3.0, 3.1, 2.9,
    2.1 and 1.4 times the yield displacement, and the upper three stay below it; linear springs would drift
    5.8 times as far at the base.

    Parameters
    ----------
    theta : float or TensorVariable
        Factor of the initial stiffness, and so of the yield force, of springs 0 to 2 [-].
    stiffness : float
        Nominal initial stiffness [N/m]; the yield displacement stays.

    Examples
    --------
    >>> bouc_wen_chain(1.2).stiffness[:4] * YIELD_DISPLACEMENT  # N, without hardening
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


STRUCTURES = {
    "linear": StudyStructure(
        "linear",
        "linear chain",
        paper.chain,
        WITH_REFERENCE,
        draws=2000,
        chains=4,
    ),
    "bouc-wen": StudyStructure(
        "bouc-wen",
        "Bouc-Wen chain",
        bouc_wen_chain,
        ("NORM", "TN", "EXP", "ABC"),
        # few large chains: small stages often miss the one per cent of the prior where the posterior lies
        draws=1000,
        chains=2,
        quick_seconds=8.0,
    ),
}


def find_structure(name: str, *, stiffness: float = paper.STIFFNESS) -> StudyStructure:
    """Return the structure of this name, with a nominal stiffness [N/m] of its springs."""
    entry = STRUCTURES[check_choice(name, "structure", STRUCTURES)]
    return replace(entry, stiffness=check_number(stiffness, "stiffness", "Pass N/m."))
