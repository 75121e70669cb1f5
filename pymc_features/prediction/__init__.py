"""Predictions from posterior draws: bands of the response, probabilities of exceedance, best sensors."""

from pymc_features.prediction.first_passage import first_passage_probability
from pymc_features.prediction.posterior_response import posterior_response
from pymc_features.prediction.sensors import sensor_placement

__all__ = ["first_passage_probability", "posterior_response", "sensor_placement"]
__dir__ = __all__.copy
