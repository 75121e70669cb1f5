"""Other tools on the same structures: one tool, one file.

Each has a function `prepare(population)` that returns a call without arguments, which returns e_j, shape
(P, s), and raises ImportError where the tool is not installed. They march at their own steps, so that their
numbers differ from ours; by how much is printed beside their cost.
"""

from collections.abc import Callable
from typing import NamedTuple

from benchmarks.peers import compiled_scipy, diffrax_steps, jax_exponential, opensees_chain


class Peer(NamedTuple):
    """What a tool can do, and on how many particles to time it."""

    prepare: Callable
    structures: tuple
    particles: int


LINEAR = "chain", "LinearStructure", "coupled damping"
YIELDING = "HystereticChain", "DuffingChain"

PEERS = {
    "JAX, matrix exponential and scan": Peer(jax_exponential.prepare, LINEAR, 16),
    "diffrax, Tsit5": Peer(diffrax_steps.prepare, YIELDING, 8),
    "SciPy DOP853, compiled right-hand side": Peer(compiled_scipy.prepare, YIELDING, 1),
    "OpenSees, Newmark, ten steps a sample": Peer(opensees_chain.prepare, ("chain", "HystereticChain"), 1),
}
