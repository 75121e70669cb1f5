"""Layout of the memory in which a nonlinear chain is integrated.

A chain works in one piece of memory, which compiled code reaches by its address (`vector_memory.aligned`
says why). It is divided into blocks of p numbers, p the number of springs n rounded up to full vectors; entry
i of a block belongs to spring i or to the degree of freedom above it.

==================  =======================================  ==========
Block               Memory of the chain                      Unit
==================  =======================================  ==========
0 ... 7             parameters of the law, one block each    the law's
`ACTIVE`            1, or 0 in the padding beyond n          -
`INVERSE_MASS`      1/m_i                                    1/kg
`STIFFNESS`         k_i                                      N/m
`DASHPOT`           beta k_i, stiffness-proportional         N s/m
`MASS_DAMPING`      alpha, mass-proportional                 1/s
`SCALARS`           three numbers, named below               -
`CROSSINGS` (2)     how often each of 2n kinks was passed    -
`BRANCH`            1 where springs are loaded, -1 where     -
                    they are unloaded
`STATES` + 3 s      state at stage s: u, v and z, a block    m, m/s, -
                    each
`SLOPES` + 3 s      its time derivative: u', v' and z'
`MODAL_DAMPING`     columns of M^-1 C of modal ratios (n)    1/s
==================  =======================================  ==========

Stage 0 is the start of a step and holds the present state between steps; stages 1 to 5 lie within the step,
and stage `LAST` = 6 is its end.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import aligned, read_lanes, read_number, write_number
from pymc_features.simulators.nonlinear.law import MAX_PARAMETERS

N_STAGES = 7
LAST = N_STAGES - 1

ACTIVE, INVERSE_MASS, STIFFNESS, DASHPOT, MASS_DAMPING, SCALARS, CROSSINGS = range(
    MAX_PARAMETERS, MAX_PARAMETERS + 7
)
BRANCH = CROSSINGS + 2
STATES = BRANCH + 1
SLOPES = STATES + 3 * N_STAGES
MODAL_DAMPING = SLOPES + 3 * N_STAGES
# Scalars: largest rate of change of the linear chain [1/s]; 1 if there is damping by modal ratios, else 0;
# number of parts into which every step is divided
LINEAR_RATE, HAS_MODAL_DAMPING, REFINE = range(3)


def padded(n: int) -> int:
    """The number n rounded up to full vectors."""
    return LANES * -(-n // LANES)


def chain_memory(n: int) -> np.ndarray:
    """Memory of a chain of n degrees of freedom; zero."""
    return aligned((MODAL_DAMPING + n) * padded(n))


@jit
def state(law, s):
    """Where the state of stage `s` begins, in vectors."""
    return (STATES + 3 * s) * law.rows


@jit
def slope(law, s):
    """Where the slope of stage `s` begins, in vectors."""
    return (SLOPES + 3 * s) * law.rows


@jit
def constant(law, block, row):
    """Group `row` of a block of the chain's memory."""
    return read_lanes(law.address, block * law.rows + row)


@jit
def scalar(law, name):
    """One of the scalars of the chain."""
    return read_number(law.address, SCALARS * law.rows * LANES + name)


@jit
def put(law, block, i, value):
    """Write entry `i` of a block of the chain's memory."""
    write_number(law.address, block * law.rows * LANES + i, value)
