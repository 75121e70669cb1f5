"""The source's numerical study, and exact posteriors to judge it by."""

from pymc_features.study import paper
from pymc_features.study.sampling_rate import sampling_rate_study
from pymc_features.study.store import StudyMismatchError
from pymc_features.study.table import as_csv, as_markdown

__all__ = ["StudyMismatchError", "as_csv", "as_markdown", "paper", "sampling_rate_study"]
