"""Ops that take statistics of misfits, and their gradients, from tables where the record is long."""

from pymc_features.ops.base import prepared
from pymc_features.simulators.mean_squares.gradient.population import misfit_gradient
from pymc_features.simulators.mean_squares.population import is_long_alone, misfits


def uncopied(op, inputs):
    """The named tuples of a kernel, with a row for each particle, and what comes behind them.

    No copies of record and data, which the tables know by their memory.
    """
    record, common = op.at("acceleration"), list(inputs[: op.n_common])
    for i, x in enumerate(common):
        if i < op.n_parameters and not op.batched:
            common[i] = prepared(x[None])
        elif i != record:
            common[i] = prepared(x)
    return op.spec.assemble(common, op.quantity_code), inputs[op.n_common :]


def has_tables(op, inputs) -> bool:
    """Whether tables are faster for one structure by itself."""
    stride, n_modes, observed = inputs[op.at("stride")], inputs[op.at("n_modes")], inputs[op.n_common]
    return "gradient_of_sums" in op.spec.kernels and is_long_alone(stride, observed, n_modes)


class StatisticsFromTables:
    """Base of Ops for statistics of the misfit of one structure."""

    def run(self, inputs):
        """From tables, where the record is long and the structure has modes."""
        if not has_tables(self, inputs):
            return super().run(inputs)
        arguments, [observed] = uncopied(self, inputs)
        return (misfits(self.spec, arguments, observed, f"population_{self.kernel_name}", is_alone=True)[0],)


class GradientFromTables:
    """Base of Ops for the gradient by these statistics."""

    def run(self, inputs):
        """From tables, as `StatisticsFromTables`."""
        if not has_tables(self, inputs):
            return super().run(inputs)
        arguments, [observed, weights] = uncopied(self, inputs)
        gradient = misfit_gradient(self.spec, arguments, observed, weights[None], is_alone=True)
        return tuple(x[0] for x in gradient)
