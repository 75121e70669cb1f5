"""x"""
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.structures import *
from pymc_features.ops import *
from pymc_features.distributions import *
