"""Simulators outside PyTensor: run in processes of their own, here or elsewhere, remembered and emulated."""

from pymc_features.lazy import lazily

TYPE_CHECKING = False  # that of `typing`
if TYPE_CHECKING:
    from pymc_features.external.emulation import Emulation, emulate  # noqa: F401
    from pymc_features.external.program import ProgramSimulator  # noqa: F401
    from pymc_features.external.simulator import ExternalSimulator  # noqa: F401

# samplers run their populations on `workers`: these are not to import what stands on samplers
PLACES = {
    "Emulation": "emulation",
    "ExternalSimulator": "simulator",
    "ProgramSimulator": "program",
    "emulate": "emulation",
}
__all__ = [*PLACES]
__getattr__, __dir__ = lazily(__name__, PLACES)
