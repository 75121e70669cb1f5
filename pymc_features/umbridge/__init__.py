"""Models and samplers in other languages, over the protocol of UM-Bridge."""

from pymc_features.umbridge.client import RemoteModel, from_umbridge
from pymc_features.umbridge.server import serve

__all__ = ["RemoteModel", "from_umbridge", "serve"]
