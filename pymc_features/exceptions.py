"""What this package raises and what it warns of, as `pymc_features.exceptions`.

    warnings.simplefilter("ignore", pmf.exceptions.FeatureLikelihoodWarning)

Arguments out of their range raise Python's own `ValueError` and `TypeError`; some of the errors here are one.
"""

# ---- data ----


class ChannelWarning(UserWarning):
    """Measured channels can be used, but something about them is suspicious."""


class ModalDataWarning(UserWarning):
    """Identified modes can be used, but something about them is suspicious."""


class DatasetUnavailableError(OSError):
    """A data set is neither in the local folder nor can it be downloaded."""


# ---- models ----


class FeatureLikelihoodWarning(UserWarning):
    """The posterior of a feature likelihood will not mean what the user expects."""


class AmbientWarning(UserWarning):
    """A band has no mode, or a record is too short for one."""


class ModalMatchWarning(UserWarning):
    """An identified mode is like no mode of the model."""


class SimulationWarning(UserWarning):
    """A simulator function raised an exception or returned a wrong shape; the parameters count as failed."""


class TooStiffError(ValueError):
    """A yielding chain has a mode that no step is small enough for."""


class NotDifferentiableError(RuntimeError):
    """A gradient was asked of what has none.

    Not a `NotImplementedError`: PyMC answers that one by a silent change to Metropolis or Slice.
    """


# ---- sampling and prediction ----


class PopulationWarning(UserWarning):
    """Particles are evaluated one by one."""


class CalibrationWarning(UserWarning):
    """An interval that was calibrated by the residuals may still be wrong, and why."""


class SamplingWarning(UserWarning):
    """Draws or an evidence are not to be trusted as they are."""


class SubsetSimulationWarning(UserWarning):
    """A soft kernel is replaced by the threshold, or draws are correlated."""


class ChainsDisagreeWarning(UserWarning):
    """Chains have not explored the same posterior."""


class LaplaceWarning(UserWarning):
    """The posterior is far from the Gaussians that stand for it."""


class PriorWarning(UserWarning):
    """The priors expect what no structure has, or what the data contradict."""


class PredictionWarning(UserWarning):
    """Draws of a posterior that describe no structure are left out of a prediction."""


class NoSpreadError(ValueError):
    """All particles of a stage are the same in a parameter: too few were inside the posterior."""


class ToleranceNotReachedError(RuntimeError):
    """The tolerance asked for was not reached; the message says which one was."""


class CheckpointError(RuntimeError):
    """A checkpoint that is damaged, in use, or of another run."""


# ---- studies and updates ----


class StudyMismatchError(ValueError):
    """The output folder holds a study, or an update, with other settings, or a damaged one."""


class ConfigError(ValueError):
    """A configuration file that cannot be used; the message names the key."""


class UncalibratedError(ConfigError):
    """Residuals can tell no width of a posterior; the others of an update are not touched."""


# ---- external simulators ----


class UnknownIdentityError(TypeError):
    """An object whose contents cannot be told, so that no cache can be trusted with it."""


class UnusableSimulatorError(RuntimeError):
    """A simulator that cannot be loaded where it is to run."""

    def __init__(self, reason: str):
        super().__init__(
            f"the simulator must be loadable in another process, got {reason}. Define it in a module that "
            "can be imported there, or in the script itself."
        )
        self.reason = reason

    def __reduce__(self):
        return type(self), (self.reason,)


class DiedAtStartError(RuntimeError):
    """A simulator process that ended before it was ready."""


class NoWorkersError(RuntimeError):
    """An executor that runs nothing any more."""


__all__ = sorted(name for name in globals() if name.endswith(("Error", "Warning")))
__dir__ = __all__.copy
