"""Loads the JAX dispatch when a graph is compiled for JAX, and not before: JAX takes a second to import."""

from pytensor.compile import optdb
from pytensor.graph.rewriting.basic import GraphRewriter


class LoadJaxDispatch(GraphRewriter):
    """A rewrite that changes nothing: PyTensor applies it to graphs for JAX only."""

    def add_requirements(self, fgraph):
        """None."""

    def apply(self, fgraph):
        """Register our Ops with JAX."""
        import pymc_features.ops.jax_dispatch  # noqa: F401


optdb.register("pymc_features_jax_dispatch", LoadJaxDispatch(), "jax", position=0.01)
