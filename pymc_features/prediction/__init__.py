"""Predictions from posterior draws: bands of the response and probabilities of exceedance."""

from pymc_features.prediction.first_passage import first_passage_probability
from pymc_features.prediction.posterior_response import posterior_response

__all__ = ["first_passage_probability", "posterior_response"]
