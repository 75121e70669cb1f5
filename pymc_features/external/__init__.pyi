# The names of the room for type checkers, which do not see what is imported when it is asked for.

from pymc_features.external.emulation import Emulation as Emulation
from pymc_features.external.emulation import emulate as emulate
from pymc_features.external.program import ProgramSimulator as ProgramSimulator
from pymc_features.external.simulator import ExternalSimulator as ExternalSimulator
