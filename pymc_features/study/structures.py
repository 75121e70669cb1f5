"""The structures of the study. A new one is one file with its chain, and one entry here."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from pymc_features._checks import check_choice, check_number
from pymc_features.likelihoods import WITH_REFERENCE
from pymc_features.structures import Structure
from pymc_features.study import bouc_wen, paper

DEFAULT = "linear"
QUICK = {"draws": 250, "chains": 2, "multipliers": (0.2, 1.0, 10.0)}


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

    def at(self, theta=1.0) -> Structure:
        """The structure with this factor, by default the true one."""
        return self.chain(theta, stiffness=self.stiffness)


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
        bouc_wen.chain,
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
