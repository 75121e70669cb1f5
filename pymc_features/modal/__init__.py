"""Identified modes: frequencies, damping ratios and shapes, how sure they are, and several set-ups as one."""

from pymc_features.modal.data import ModalData
from pymc_features.modal.merge import merge_setups

__all__ = ["ModalData", "merge_setups"]
