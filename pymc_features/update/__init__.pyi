# The names of the room for type checkers, which do not see what is imported when it is asked for.

from pymc_features.update.examples import write_example as write_example
from pymc_features.update.problem import Problem as Problem
from pymc_features.update.problem import read_config as read_config
from pymc_features.update.problem import read_problem as read_problem
from pymc_features.update.report.outputs import write_outputs as write_outputs
from pymc_features.update.run import run_update as run_update
