"""Misfit between response and measurements at the sampling steps of the study, as functions of theta.

Four sums over the sensors are all that the likelihoods need: of e_j, of the mean squared increments of the
misfit, and of its first and last square.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from pymc_features.likelihoods.exact.quadrature import DiscrepancyCurve
from pymc_features.simulators import FAMILIES, request
from pymc_features.simulators.excitation import excitation_of
from pymc_features.structures import Structure
from pymc_features.study import paper

N_NODES = 601


def computed_sums(at: Callable[[float], Structure], record, data, dt: float) -> Callable:
    """The four sums (4,) as a function of theta at one sampling step, by the kernel of a structure's family.

    `at` makes a structure of theta, `data` (s, u) are measurements [m/s^2] with the step `dt` [s].
    """
    data = np.ascontiguousarray(data)
    asked = request(paper.N_STOREYS, record.dt, dt=dt)

    def sums(theta):
        structure = at(theta)
        family = FAMILIES[structure.family]
        excitation = excitation_of(structure.excitation(record), record, asked)
        rows = family.rows(asked.sensors, structure.n_dof)
        inputs = family.inputs_of(structure, record, excitation, rows, asked.n_modes)
        arguments = family.assemble(inputs, asked.quantity_code)
        squares, increments, first, last = family.kernels["misfit"](*arguments, data).T
        return np.array([squares.sum(), increments.sum(), first @ first, last @ last])

    return sums


class SharedResponses:
    """The four sums at all sampling steps from one response for each theta, where a response is costly.

    The response at a coarser step is every n-th sample of that at the finest, so that one response serves all
    steps: `respond(theta)` (s, u) [m/s^2], as `data` are; `strides` are the multiples of the finest step by
    any keys. It is computed at nodes of theta that resolve the narrowest posterior and cover the prior, about
    a thousand; between them the sums are cubic splines, right to 1e-6 where the posteriors are
    (tests/study/test_study_bouc_wen.py). No response is kept.
    """

    def __init__(self, respond: Callable, data: np.ndarray, strides: dict[float, int]):
        self.respond, self.data, self.strides = respond, data, strides
        self._known: dict[float, np.ndarray] = {}

    def at(self, theta: float) -> np.ndarray:
        """The four sums at each sampling step (step, 4), without splines."""
        if theta not in self._known:
            misfit = self.data - self.respond(theta)
            self._known[theta] = np.array([sums_of(misfit[:, ::n]) for n in self.strides.values()])
        return self._known[theta]

    @cached_property
    def curve(self) -> DiscrepancyCurve:
        """S(theta) at the finest step: its nodes are those of the splines."""
        finest = list(self.strides.values()).index(1)
        return DiscrepancyCurve(
            lambda theta: float(self.at(theta)[finest, 0]), paper.THETA_RANGE, self.data.size, N_NODES
        )

    @cached_property
    def splines(self) -> CubicSpline:
        """The sums (step, 4) by the grid variable of `curve`."""
        return CubicSpline(self.curve.u, np.array([self.at(theta) for theta in self.curve.theta]))

    def sums(self, multiplier: float) -> Callable:
        """theta -> array (4,) at one sampling step."""
        row = list(self.strides).index(multiplier)
        return lambda theta: self.splines(self.curve.grid_variable(theta))[row]


def sums_of(misfit: np.ndarray) -> np.ndarray:
    """The four sums (4,) of a misfit (s, u)."""
    squares, increments = ((x**2).sum() / misfit.shape[1] for x in (misfit, np.diff(misfit, axis=1)))
    return np.array([squares, increments, (misfit[:, 0] ** 2).sum(), (misfit[:, -1] ** 2).sum()])
