"""Specimens of cyclic tests, whose displacement is prescribed, and what cycles do to them."""

from pymc_features.structures.specimens.deterioration import Degradation, Pinching
from pymc_features.structures.specimens.specimen import HystereticSpecimen

SPECIMENS = (HystereticSpecimen,)
DETERIORATIONS = (Degradation, Pinching)

__all__ = ["DETERIORATIONS", "SPECIMENS", "Degradation", "HystereticSpecimen", "Pinching"]
