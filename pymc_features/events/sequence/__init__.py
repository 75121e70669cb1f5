"""Updating in sequence: the posterior of one event is the prior of the next."""

from pymc_features.events.sequence.continuing import continue_with
from pymc_features.events.sequence.run import sample_in_sequence

__all__ = ["continue_with", "sample_in_sequence"]
