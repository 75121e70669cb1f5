"""Several events or specimens, from the posteriors that each of them has given."""

from pymc_features.events.compare import compare
from pymc_features.events.hierarchical import hierarchical
from pymc_features.events.sequence import continue_with, sample_in_sequence

__all__ = ["compare", "continue_with", "hierarchical", "sample_in_sequence"]
__dir__ = __all__.copy
