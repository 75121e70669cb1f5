"""Simulators outside PyTensor: run in processes of their own, here or elsewhere, remembered and emulated."""

from pymc_features.lazy import lazily

__all__ = [
    "Emulation",
    "EvaluationCache",
    "Evaluator",
    "ExternalSimulator",
    "Failure",
    "ProgramSimulator",
    "emulate",
]

# samplers run their populations on `workers`: these are not to import what stands on samplers
__getattr__, __dir__ = lazily(
    __name__,
    {
        "Emulation": "emulation",
        "EvaluationCache": "cache",
        "Evaluator": "evaluator",
        "ExternalSimulator": "simulator",
        "Failure": "evaluator",
        "ProgramSimulator": "program",
        "emulate": "emulation",
    },
)
