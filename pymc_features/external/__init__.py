"""Simulators outside PyTensor: run in processes of their own, here or elsewhere, remembered and emulated."""

from pymc_features.lazy import lazily

# samplers run their populations on `workers`: these are not to import what stands on samplers
PLACES = {
    "Emulation": "emulation",
    "ExternalSimulator": "simulator",
    "ProgramSimulator": "program",
    "emulate": "emulation",
}
__all__ = [*PLACES]
__getattr__, __dir__ = lazily(__name__, PLACES)
