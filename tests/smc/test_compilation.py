"""What is compiled around the kernels of a population, and what is not."""

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.link.basic import PerformLinker
from pytensor.scalar import Add, Cast, Mul
from pytensor.tensor.elemwise import Elemwise

from pymc_features import ExpFeature, ModalDamping, SpringMassChain, response, synthetic_earthquake
from pymc_features.smc import population_logp
from pymc_features.smc.density.compilation import has_python_loops, with_mode

pytestmark = pytest.mark.default_mode
RECORD = synthetic_earthquake(2.0, 0.02, random_seed=1)


def declare():
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        chain = SpringMassChain([1.0, 1.0], 400.0 * theta, ModalDamping(0.02))
        ExpFeature("y", response(chain, RECORD), pm.HalfNormal("sigma"), observed=np.ones((2, 101)))
    return model


def test_a_new_model_needs_no_compilation_and_python_is_called_for_no_single_number():
    """NumPy or SciPy has a function for every operation on arrays, those of bounded priors included."""
    model = declare()
    logp = population_logp(model, model.initial_point(), {})
    assert isinstance(logp.function.maker.linker, PerformLinker)
    logp.compile_gradient()
    for function in (logp.values.function, logp.slopes.function):
        operations = [node.op for node in function.maker.fgraph.toposort() if isinstance(node.op, Elemwise)]
        folded = (Add, Mul, Cast)  # by PyTensor itself
        alone = [op for op in operations if not (op.nfunc_spec or isinstance(op.scalar_op, folded))]
        assert operations and not alone
    assert cloudpickle.dumps(logp.slopes), "processes of chains take it"
    x = np.array([[-1.0, 0.2], [-40.0, 0.2], [0.3, -1.0], [20.0, 0.2], [40.0, 0.2]])
    uniform = -np.logaddexp(0.0, x[:, 0]) - np.logaddexp(0.0, -x[:, 0])  # with its logit's derivative
    half_normal = 0.5 * np.log(2.0 / np.pi) - 0.5 * np.exp(2.0 * x[:, 1]) + x[:, 1]
    np.testing.assert_allclose(logp(x)[0], uniform + half_normal, rtol=1e-13)


def test_what_the_user_asks_for_comes_first():
    assert with_mode({"mode": "NUMBA"}, []) == {"mode": "NUMBA"}
    with pytensor.config.change_flags(mode="NUMBA"):
        assert with_mode({}, []) == {}


@pytest.mark.parametrize(
    ("loops", "declared"),
    [
        (False, lambda x: pt.vectorize(lambda row: pt.dot(np.eye(3), row), signature="(a)->(b)")(x)),
        (True, lambda x: pt.vectorize(lambda row: pt.linalg.expm(pt.diag(row)), signature="(a)->(b,b)")(x)),
        (True, lambda x: pytensor.scan(lambda row, sum: sum + row, x, pt.zeros(3), return_updates=False)),
    ],
)
def test_loops_in_python_are_seen(loops, declared):
    assert has_python_loops([declared(pt.matrix("x"))]) == loops
