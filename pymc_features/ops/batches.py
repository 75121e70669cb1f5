"""How Ops take batches of their inputs: as rows of one call, where parameters alone have them."""

import pytensor.tensor as pt
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise


def in_one_call(op, population, inputs, ndims) -> list:
    """Outputs of an Op for inputs with any leading batch dimensions.

    Batches of parameters alone become one call of the Op of the population; others are left to `Blockwise`.
    """
    n = op.n_parameters
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, ndims, strict=True)]
    alone = [x.type.ndim == ndim for x, ndim in zip(inputs, ndims, strict=True)]
    if op.batched or not all(alone[n:]):
        return Blockwise(op)(*inputs, return_list=True)
    if all(alone):
        return op(*inputs, return_list=True)
    rows, batch = as_rows(inputs[:n], ndims[:n])
    results = population(*rows, *inputs[n:], return_list=True)
    if batch is None:
        return results
    return [x.reshape((*batch, *tuple(x.shape)[1:]), ndim=len(batch) + x.ndim - 1) for x in results]


def as_rows(parameters, ndims):
    """Parameters with any leading batch dimensions as rows of a population, one row for what has none.

    Returns also the shape of the batch, None if it has one dimension: the rows are its entries then.
    """
    depths = [x.type.ndim - ndim for x, ndim in zip(parameters, ndims, strict=True)]
    batch = None
    if max(depths) > 1:
        leading = [tuple(x.shape)[:own] for x, own in zip(parameters, depths, strict=True) if own]
        batch = tuple(pt.broadcast_shape(*leading, arrays_are_shapes=True))
        parameters = [
            flat_batch(x, batch, own) if own else x for x, own in zip(parameters, depths, strict=True)
        ]
    return [x if own else x[None] for x, own in zip(parameters, depths, strict=True)], batch


def flat_batch(x, batch, depth):
    """Spread the first `depth` dimensions over `batch` and make one of them."""
    core = tuple(x.shape)[depth:]
    return pt.broadcast_to(x, (*batch, *core)).reshape((-1, *core), ndim=1 + len(core))


def without_unit_batch(x, ndim):
    """Drop leading dimensions beyond `ndim` that have length one by their type, as `Blockwise` adds them."""
    extra = x.type.ndim - ndim
    if extra > 0 and all(x.type.broadcastable[:extra]):
        return x.dimshuffle(*range(extra, x.type.ndim))
    return x


def take_batches(*op_classes, first: int | None = None):
    """Let the first inputs of Ops, by default all, have any leading dimensions; the others are without."""

    def vectorize(op, node, *inputs):
        n = len(inputs) if first is None else first
        shared = [without_unit_batch(x, y.ndim) for x, y in zip(inputs[n:], node.inputs[n:], strict=True)]
        if any(x.ndim != y.ndim for x, y in zip(shared, node.inputs[n:], strict=True)):
            raise NotImplementedError(f"all inputs of {op} but the first {n} are the same for all particles")
        return op(*inputs[:n], *shared, return_list=True)

    for op_class in op_classes:
        _vectorize_node.register(op_class)(vectorize)
