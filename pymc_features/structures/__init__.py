"""Structures and their damping. A new structure is a class here and one line below."""

from pymc_features.records import CyclicTest
from pymc_features.simulators.spring_forces import integration_error, spring_forces
from pymc_features.structures.affine import AffineStructure
from pymc_features.structures.base import Input, Kind, Matrices, Modes, Structure
from pymc_features.structures.chains import DuffingChain, HystereticChain, SpringMassChain
from pymc_features.structures.damping import Damping, ModalDamping, RayleighDamping
from pymc_features.structures.linear import LinearStructure
from pymc_features.structures.specimens import Degradation, HystereticSpecimen, Pinching

STRUCTURES = (SpringMassChain, LinearStructure, AffineStructure, HystereticChain, DuffingChain)
DAMPINGS = (RayleighDamping, ModalDamping)

__all__ = [
    "DAMPINGS",
    "STRUCTURES",
    "AffineStructure",
    "CyclicTest",
    "Damping",
    "Degradation",
    "DuffingChain",
    "HystereticChain",
    "HystereticSpecimen",
    "Input",
    "Kind",
    "LinearStructure",
    "Matrices",
    "ModalDamping",
    "Modes",
    "Pinching",
    "RayleighDamping",
    "SpringMassChain",
    "Structure",
    "integration_error",
    "spring_forces",
]
__dir__ = __all__.copy
