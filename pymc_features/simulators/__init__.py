"""Arrays in, arrays out: response, misfit and their derivatives, as compiled kernels.

Rooms: `compiled` (machine code), `numbers` (one source for one structure and for many, with derivatives and
without), `oscillators` (modes through time, and gradients), `eigen` (modes of many structures together),
`long_records` (without going through time), `taylor` (populations of nonlinear chains through time), `chain`,
`linear`, `nonlinear` and `cyclic` (from the parameters of a family to its modes, states or forces), `modal`
(modes for their own sake), and above them `families`, the table of all kernels. Nothing here knows of PyMC or
PyTensor.

Symbols, as in the equations of the documentation:

===============================  ============================================================================
`mass`, `damping`, `stiffness`  M [kg], C [N s/m], K [N/m] of M x" + C x' + K x = load
`theta`                         parameters of the matrices, A(theta) = A_0 + sum_i theta_i A_i
`rayleigh`, `ratios`            alpha [1/s] and beta [s]; damping ratios [-] added to Rayleigh's
`omega`                         angular frequencies of the modes [rad/s]; lambda = omega^2
`modal_damping`                 D = 2 zeta omega = alpha + beta omega^2 + 2 ratio omega [1/s]
`shapes`, `rows`                mode shapes Phi, Phi' M Phi = 1, in columns or in rows; S Phi at the outputs S
`participation`                 Gamma = Phi' load: of unit accelerations of the supports, or of unit forces
`influence`, `support_motion`   iota, displacements under unit displacements of the supports; S iota
`feed`                          J of Eq. (24), what stands before the inputs in the response
`acceleration`, `ground`        inputs at the record's samples; at the steps of the recursion
`dt`, `step`                    sampling interval of the record [s]; h = dt / substeps of the recursion [s]
`s`, `d`                        (omega h)^2 and D h of the recursion [-]
`observed`, `misfit`            data y; r = y - g; its statistics e (Eq. 3), squared increments, first, last
`weights`, `cotangent`          derivatives of a number L by those statistics; by the response
`z`                             internal variable of a hysteretic spring [-]
===============================  ============================================================================

Letters for sizes: n degrees of freedom, m modes kept, s sensors, d inputs, t samples of the record, u of the
response, p particles or parameters. The derivative of L by x is `grad_x`, a direction of x `d_x`.
"""

from pymc_features.simulators.chain.kernels import (
    chain_discrepancy,
    chain_misfit,
    chain_response,
    misfit_gradient,
    population_discrepancy,
    population_gradient,
    population_misfit,
    response_gradient,
)
from pymc_features.simulators.chain.parameters import ChainParameters
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.oscillators.arguments import QUANTITIES, Excitation, Outputs, n_outputs
from pymc_features.simulators.quantities import (
    HISTORIES,
    at_outputs,
    checked_request,
    force_share,
    quantities_of,
    rows_of,
)
from pymc_features.simulators.request import CODES, UNITS, request
from pymc_features.simulators.simulate import SIMULATED, simulate, times_of
from pymc_features.simulators.spring_forces import integration_error, spring_forces

__all__ = [
    "CODES",
    "FAMILIES",
    "HISTORIES",
    "QUANTITIES",
    "SIMULATED",
    "ChainParameters",
    "Excitation",
    "Outputs",
    "UNITS",
    "at_outputs",
    "chain_discrepancy",
    "chain_misfit",
    "chain_response",
    "checked_request",
    "misfit_gradient",
    "force_share",
    "integration_error",
    "n_outputs",
    "quantities_of",
    "population_discrepancy",
    "population_gradient",
    "population_misfit",
    "request",
    "response_gradient",
    "rows_of",
    "simulate",
    "spring_forces",
    "times_of",
]
