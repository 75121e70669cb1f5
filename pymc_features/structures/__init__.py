"""Structures and their damping. A new structure is one file here and one line below."""

from pymc_features.structures.base import Modes, Structure
from pymc_features.structures.chain import SpringMassChain
from pymc_features.structures.damping import Damping, ModalDamping, RayleighDamping
from pymc_features.structures.duffing import DuffingChain
from pymc_features.structures.hysteretic import HystereticChain

STRUCTURES = (SpringMassChain, HystereticChain, DuffingChain)
DAMPINGS = (RayleighDamping, ModalDamping)

__all__ = [
    "DAMPINGS",
    "STRUCTURES",
    "Damping",
    "DuffingChain",
    "HystereticChain",
    "ModalDamping",
    "Modes",
    "RayleighDamping",
    "SpringMassChain",
    "Structure",
]
