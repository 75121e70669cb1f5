"""Ground motions, measured channels and cyclic tests of many formats; matrices of structures."""

from pymc_features.io.channels import read_channels, read_channels_with_gaps
from pymc_features.io.formats import FORMATS
from pymc_features.io.frequency_response import read_frequency_response
from pymc_features.io.matrices import read_matrices
from pymc_features.io.records import read_cyclic_test, read_record
from pymc_features.io.write import write_channels

__all__ = [
    "FORMATS",
    "read_channels",
    "read_channels_with_gaps",
    "read_cyclic_test",
    "read_frequency_response",
    "read_matrices",
    "read_record",
    "write_channels",
]
__dir__ = __all__.copy
