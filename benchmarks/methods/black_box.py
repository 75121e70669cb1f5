"""PyMC's kernel on a black-box Op around SciPy: what people write today, written well."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op

from benchmarks.methods.pymc_smc import STOCK, sample
from benchmarks.routes import filters, state_space

RESPONSES = {"lfilter": filters.response, "lsim": state_space.response}


class BlackBox(Op):
    """Response history (sensor, time) of the ten-storey chain, one SciPy call for each evaluation."""

    __props__ = ("route", "dt")

    def __init__(self, route, dt):
        self.route, self.dt = route, dt

    def make_node(self, theta, acceleration):
        inputs = [pt.as_tensor_variable(theta), pt.as_tensor_variable(acceleration)]
        return Apply(self, inputs, [pt.matrix(dtype="float64")])

    def perform(self, node, inputs, output_storage):
        theta, acceleration = inputs
        stiffness = np.full(10, 1800.0)
        stiffness[:3] *= theta
        output_storage[0][0] = RESPONSES[self.route](stiffness, acceleration, self.dt)


def method(problem, seed):
    """IMH on the `lfilter` route; its draws are those of IMH on our Op but for rounding."""
    if not hasattr(problem, "black_box"):
        op = BlackBox("lfilter", problem.record.dt)
        problem.black_box = problem.declare(lambda theta: op(theta, problem.record.acceleration))
    return sample(STOCK["IMH"], problem.black_box, seed, count=True)
