"""Exact response of any linear structure to several inputs that are linear between their samples.

In mass-normalised modes x = Phi q, a linear structure under the inputs a(t) (d,) obeys

    q" + D q' + Omega^2 q = -Gamma a(t),   D = Phi' C Phi,   Gamma = Phi' M influence  or  -Phi' B,

for support accelerations or for forces B a(t). Where D is diagonal (classical damping) each mode is
the oscillator of `recursion`, and the responses to the inputs add up. Where it is not, the modes are
carried together, see `state_space`.
"""

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.recursion import (
    ABSOLUTE_ACCELERATION,
    BLOCK,
    N_ROWS,
    RELATIVE_ACCELERATION,
    advance,
    first_order_hold,
    n_outputs,
    output_row,
)
from pymc_features.simulators.state_space import state_response, step_matrices

COUPLING = 1e-12  # off-diagonal entries of D below this times the largest are rounding
SMALLEST_FREQUENCY = 1e-100  # rad/s, stands for zero: its square underflows, and D = 2 zeta omega is kept


@jit
def modal_table(omega, zeta, step, quantity, table):
    """Write the recursion table (11, m) of oscillators; False where one cannot be stepped."""
    for r in range(omega.size):
        w = omega[r] * step
        if not (w < 1e6 and 0.0 <= zeta[r] * w < 1e6):  # NaN, growing, or absurdly stiff
            return False
        first_order_hold(w, zeta[r], table, r)
        output_row(quantity, w, zeta[r], step, table, r)
    return True


@jit
def superposed_response(table, shapes, direct, inputs, substeps, stride):
    """Response (s, u) of uncoupled modes, the sum over the inputs.

    Parameters
    ----------
    table : array (11, m)
        From `modal_table`.
    shapes : array (d, s, m)
        Output of each mode per unit participation, times its participation in each input.
    direct : array (s, d)
        Feed-through of the inputs.
    inputs : array (d, t)
    substeps, stride : int
        As in `advance`.
    """
    n_modes = table.shape[1]
    n_sensors = direct.shape[0]
    total = n_outputs(inputs.shape[1], substeps, stride)
    response = np.zeros((n_sensors, total))
    modal = np.empty((BLOCK, n_modes))
    ground = np.empty(BLOCK)
    block = np.empty((n_sensors, BLOCK))
    for i in range(inputs.shape[0]):
        q = np.zeros(n_modes)
        p = np.zeros(n_modes)
        for first in range(0, total, BLOCK):
            count = min(BLOCK, total - first)
            advance(table, q, p, inputs[i], substeps, stride, first, count, modal, ground)
            np.dot(shapes[i], modal.T, block)
            for j in range(n_sensors):
                for b in range(count):
                    response[j, first + b] += block[j, b] + direct[j, i] * ground[b]
    return response


def linear_response(structure, record, asked, outputs):
    """Response of a `LinearStructure`; see `simulate`.

    `structure` gives `modes`, `modal_damping`, `influence` and `mass`; `outputs` (s, n) or None for the
    sensors of the request.
    """
    modes = structure.modes(asked.n_modes)
    shapes = modes.mode_shapes
    pick = outputs if outputs is not None else asked.sensors
    inputs, participation, static = _excitation(structure, record, shapes)
    seen = _rows(pick, shapes)
    direct = np.zeros((seen.shape[0], inputs.shape[0]))
    if asked.quantity_code in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        carried = seen @ participation
        if static is not None:
            moved = _rows(pick, static)
            if asked.n_modes == structure.n_dof:
                carried = moved  # completeness of the modes, without its rounding error
            if asked.quantity_code == ABSOLUTE_ACCELERATION:
                direct += moved
        direct -= carried
    omega = np.maximum(modes.angular_frequencies, SMALLEST_FREQUENCY)
    damping = structure.modal_damping(asked.n_modes)
    step = record.dt / asked.substeps
    grid = asked.substeps, asked.stride
    if is_coupled(damping):
        matrices = step_matrices(
            modes.angular_frequencies, damping, participation, seen, step, asked.quantity_code
        )
        return state_response(*matrices, direct, inputs, *grid)
    drag = damping if damping.ndim == 1 else np.diagonal(damping)
    zeta = np.maximum(drag, 0.0) / (2.0 * omega)  # the structure has no negative damping beyond rounding
    table = np.empty((N_ROWS, omega.size))
    if not modal_table(omega, zeta, step, asked.quantity_code, table):
        return np.full((seen.shape[0], asked.n_outputs(record.n_times)), np.nan)
    weighted = np.ascontiguousarray(participation.T[:, None, :] * seen)
    return superposed_response(table, weighted, direct, inputs, *grid)


def is_coupled(damping: np.ndarray) -> bool:
    """Whether damping, 2 zeta omega (m,) or D (m, m), couples the modes beyond rounding (1e-12)."""
    if damping.ndim == 1:
        return False
    off = damping - np.diag(np.diagonal(damping))
    return bool(abs(off).max() > COUPLING * abs(damping).max())


def _rows(pick, matrix):
    """Chosen rows of (n, ...), or combinations of them."""
    return np.ascontiguousarray(pick @ matrix if pick.ndim == 2 else matrix[pick])


def _excitation(structure, record, shapes):
    """Inputs (d, t), Gamma (m, d), and the motion (n, d) the supports impose, None under forces."""
    n = structure.n_dof
    if getattr(record, "kind", "support_acceleration") == "force":
        matrix = np.eye(n) if record.matrix is None else record.matrix
        if matrix.shape[0] != n or matrix.shape[1] != record.n_inputs:
            raise ValueError(
                f"`matrix` of the forces must have shape ({n}, {record.n_inputs}), got "
                f"{'none' if record.matrix is None else record.matrix.shape}. "
                "Give one row for each degree of freedom and one column for each input."
            )
        return record.values, -shapes.T @ matrix, None
    inputs = record.acceleration[None] if hasattr(record, "acceleration") else record.values
    static = structure.influence.reshape(n, -1)
    if inputs.shape[0] != static.shape[1]:
        raise ValueError(
            f"`record` must give {static.shape[1]} support accelerations, one for each column of "
            f"`influence`, got {inputs.shape[0]}. Pass Loading(values, dt) with that many rows."
        )
    return inputs, shapes.T @ (structure.mass @ static), static
