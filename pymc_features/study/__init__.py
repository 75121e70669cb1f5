"""The sampling-rate study, of the source's structure and of one that yields; exact posteriors to judge by."""

from pymc_features.study import paper
from pymc_features.study.results import as_csv, as_markdown, write_outputs, yielding
from pymc_features.study.sampling_rate import sampling_rate_study
from pymc_features.study.structures import STRUCTURES, StudyStructure, find_structure

__all__ = [
    "STRUCTURES",
    "StudyStructure",
    "as_csv",
    "as_markdown",
    "find_structure",
    "paper",
    "sampling_rate_study",
    "write_outputs",
    "yielding",
]
__dir__ = __all__.copy
