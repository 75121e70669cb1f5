"""Several events or specimens, from the posteriors that each of them has given."""

from pymc_features.events.compare import compare
from pymc_features.events.hierarchical import hierarchical

__all__ = ["compare", "hierarchical"]
