"""Choice of the table or the march by the number of samples, and where a compiled function has its table.

A table belongs to one node of one compiled function, and is compared with the data whenever that is called.
"""

import hashlib

from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant

from pymc_features.ops.structural import prepared
from pymc_features.simulators.long_records.misfits import Asked, Tables, from_table

# Steps of the recursion, for a population. A march of 4,000 takes 27 us for ten masses, a table 5; but the
# functions of tables take 10 s to compile, once, which hundreds of thousands of values do not bring back.
FEWEST_STEPS = 4000
FEWEST_ALONE = 4000  # samples, for one structure, whose modes do not fill the lanes of a vector
MOST_STRIDE = 8  # steps between outputs: what a table costs grows with their square


class FromTable:
    """Base of the Ops of e_j and its gradient, of one structure or of many."""

    @property
    def has_table(self) -> bool:
        """Whether the family has modes for a table, and the Op is about e_j alone."""
        name = "gradient_of_sums" if hasattr(self, "n_statistics") else "population_systems"
        return name in self.spec.kernels and getattr(self, "n_statistics", 1) == 1

    def is_long(self, n_times, stride=1) -> bool:
        """Whether a table is faster for so many samples."""
        steps = stride * n_times if self.batched else n_times
        return self.has_table and steps >= (FEWEST_STEPS if self.batched else FEWEST_ALONE)

    def perform(self, node, inputs, output_storage):
        """By the table of the node, where the record is long."""
        if not hasattr(node.tag, "tables"):
            node.tag.tables = Tables()
        for storage, result in zip(output_storage, self.run(inputs, node.tag.tables), strict=True):
            storage[0] = result

    def run(self, inputs, tables=None):
        """What the kernel makes of arrays, or the table of a node where that is faster."""
        stride, acceleration = inputs[self.at("stride")], inputs[self.at("acceleration")]
        is_fit = stride <= MOST_STRIDE and (acceleration.ndim == 1 or len(acceleration) == 1)
        if tables is None or not is_fit or not self.is_long(inputs[self.n_common].shape[1], stride):
            return super().run(inputs)
        arrays = [prepared(x) for x in inputs]
        observed, *weights = arrays[self.n_common :]
        if not self.batched:
            arrays[: self.n_parameters] = [prepared(x[None]) for x in inputs[: self.n_parameters]]
            weights = [x[None] for x in weights]
        given = self.spec.assemble(arrays[: self.n_common], self.quantity_code)
        found = from_table(tables, Asked(self.spec, given, observed, *weights, is_alone=not self.batched))
        return found if self.batched else tuple(x[0] for x in found)


def is_known_long(op, node) -> bool:
    """Whether a node is one whose data are known to be long when a function is compiled."""
    if not isinstance(op, FromTable):
        return False
    observed = node.inputs[op.n_common]
    n_times = observed.type.shape[-1]
    if n_times is None and isinstance(observed, SharedVariable):
        n_times = observed.get_value(borrow=True).shape[-1]
    return n_times is not None and op.is_long(n_times)


def hash_of_data(op, node) -> str | None:
    """Hash of data and record, the same in all processes; None unless they are constants."""
    given = node.inputs[op.n_common], node.inputs[op.at("acceleration")]
    if not all(isinstance(x, Constant) for x in given):
        return None
    return hashlib.sha256(b"".join(x.data.tobytes() for x in given)).hexdigest()
