"""From files to the response to forces that nobody measured, the bands that are compared, and their modes."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import signals
from pymc_features.ambient.bands import checked_bands
from pymc_features.exceptions import AmbientWarning, ConfigError
from pymc_features.identification import identify_modes, propose_bands
from pymc_features.modal import ModalData
from pymc_features.structures import Structure
from pymc_features.update.config.document import Config
from pymc_features.update.config.modal_section import Modal
from pymc_features.update.problem.channels import detrended, named_key, read_corrected
from pymc_features.update.problem.modes import MeasuredModes, modes_to_choose_from, points_of

PASSED = 0.4  # of the sampling rate: what decimation leaves as it was
PARTNER = {"sigma_f": 0.01, "sigma_phi": 0.05}  # by which modes of the model are matched


@dataclass(frozen=True)
class MeasuredAmbient:
    """What the model is updated with.

    Attributes
    ----------
    channels : DataArray (sensor, time)
        Measured accelerations [m/s^2] at `step`.
    step : float
        Sampling interval [s].
    bands : array (band, 2)
        Frequencies that are compared [Hz].
    source : str
        Where the channels come from.
    dofs : list of int
        Degree of freedom of each sensor.
    structure : Structure
        What the priors expect.
    """

    channels: xr.DataArray
    step: float
    bands: np.ndarray
    source: str
    dofs: list[int]
    structure: Structure

    @cached_property
    def modes(self) -> MeasuredModes | None:
        """Modes identified in the bands, when they are first asked for: that takes seconds.

        None if there are none, or more than the structure has.

        Warns
        -----
        AmbientWarning
            If a band has no mode, or a mode is too narrow, as that of a machine.
        """
        return identified(self.channels, self.bands, self.dofs, self.structure)

    @property
    def duration(self) -> float:
        """Of the record [s]."""
        return self.step * self.channels.sizes["time"]

    @property
    def sentence(self) -> str:
        """Which bands are compared, as [ambient] has them."""
        pairs = ", ".join(f"[{low:.4g}, {high:.4g}]" for low, high in self.bands)
        return f"bands = [{pairs}]  # Hz"


def compared_modes(data: ModalData) -> Modal:
    """A section [modal] by which the modes of a model are matched with those that channels have."""
    if data.shapes is None:
        return Modal(file="", shapes=False, sigma_f=PARTNER["sigma_f"])
    return Modal(file="", **PARTNER)


def read_ambient(config: Config, folder: Path, dofs: list[int], structure: Structure) -> MeasuredAmbient:
    """Read, correct and process the channels, and find bands if it is asked for.

    Files are relative to `folder`; `dofs` are those of the sensors, `structure` is what the priors expect.

    Raises
    ------
    ConfigError
        If a file is missing or broken, or a band holds too few frequencies; the message names the key.
    """
    channels, source = read_corrected(config, folder)
    asked = config.processing
    channels = detrended(channels, asked)
    if asked.trim is not None:
        with named_key("processing.trim"):
            channels = signals.trim(channels, *asked.trim)
    with named_key("processing.decimate"):
        channels = signals.decimate(channels, asked.decimate)
    with named_key("data"):
        step = signals.sampling_step(channels)
    bands = config.ambient.bands
    with named_key("ambient.bands"):
        bands = propose_bands(channels) if bands == "auto" else bands
        bands = checked_bands(bands, channels.sizes["time"], step, 0).limits
    if asked.decimate > 1 and bands.max() > PASSED / step:
        raise ConfigError(
            f"`ambient.bands` must end below {PASSED / step:.4g} Hz after `processing.decimate`, got "
            f"{bands.max():.4g} Hz: decimation weakens what is above. Decimate less."
        )
    return MeasuredAmbient(channels, step, bands, source, dofs, structure)


def identified(channels, bands, dofs, structure) -> MeasuredModes | None:
    """The modes that channels have in some bands, where a model can have as many."""
    try:
        with named_key("ambient.bands"):
            data = identify_modes(channels, bands)
    except ConfigError as error:
        warnings.warn(f"No modes were identified to compare with: {error}", AmbientWarning, stacklevel=2)
        return None
    if len(dofs) < 2:  # a shape of one entry says nothing
        known = {name: getattr(data, name) for name in ("frequency_sd", "damping_ratios", "damping_sd")}
        data, dofs = ModalData(data.frequencies, **known), []
    section, numbers = compared_modes(data), list(range(1, len(data) + 1))
    try:
        n_modes = modes_to_choose_from(section, len(data), structure)
    except ConfigError:
        warnings.warn(
            f"The channels have {len(data)} modes in the bands, more than the structure: it cannot explain "
            "all of them. Choose `ambient.bands` around those that it has.",
            AmbientWarning,
            stacklevel=2,
        )
        return None
    points = points_of(section, data, dofs, Path(), structure)
    return MeasuredModes(data, numbers, numbers, dofs, n_modes, points, "the spectra in the bands")
