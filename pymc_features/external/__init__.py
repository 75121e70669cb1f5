"""Simulators outside PyTensor: run in processes of their own, here or on a cluster, and remembered."""

from pymc_features.external.cache import EvaluationCache
from pymc_features.external.evaluator import Evaluator, Failure
from pymc_features.external.program import ProgramSimulator
from pymc_features.external.simulator import ExternalSimulator

__all__ = ["ProgramSimulator", "EvaluationCache", "Evaluator", "ExternalSimulator", "Failure"]
