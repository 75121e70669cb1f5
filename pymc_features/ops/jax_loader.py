"""Loads the JAX dispatch when a graph is compiled for JAX, and not before: JAX takes a second to import."""

from importlib import import_module

from pytensor.compile import optdb
from pytensor.graph.rewriting.basic import GraphRewriter


class LoadJaxDispatch(GraphRewriter):
    """A rewrite that changes nothing: PyTensor applies it to graphs for JAX only."""

    def add_requirements(self, fgraph):
        """None."""

    def apply(self, fgraph):
        """Register our Ops with JAX."""
        import_module("pymc_features.ops.jax_dispatch")  # which imports the Ops, and stands above them


optdb.register("pymc_features_jax_dispatch", LoadJaxDispatch(), "jax", position=0.01)
