"""What a reader of modes returns, and how it becomes `ModalData`."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pymc_features.modal import ModalData
from pymc_features.modal.data import find_channels, listed
from pymc_features.modal.shapes import COLLINEAR, warn_modes

DAMPED = 0.3  # a damping ratio above it is more likely a percentage
ALONE = 30.0  # an entry of a shape this many times the second is more likely spoilt
SPREAD = 0.5  # so is a standard deviation above this fraction of its frequency


class Identified(NamedTuple):
    """Modes as a source states them, in Hz and fractions; None where it is silent."""

    source: str  # what messages call it: the name of the file
    frequencies: np.ndarray  # (m,), as the next three
    frequency_sd: np.ndarray | None = None
    damping: np.ndarray | None = None
    damping_sd: np.ndarray | None = None
    shapes: np.ndarray | None = None  # (m, s), as the next
    shape_sd: np.ndarray | None = None
    channels: list[str] | None = None
    labels: list[str] | None = None  # which mode each is of, where some are of the same


def modal_data(found: Identified, channels, real: bool) -> ModalData:
    """The modes with the names and channels that the caller asks for, and real shapes if they shall be."""
    try:
        names, columns = _named(found, channels)
        shapes, shape_sd = (
            None if a is None else np.asarray(a)[:, columns] for a in (found.shapes, found.shape_sd)
        )
        modal = ModalData(
            found.frequencies,
            shapes,
            names,
            frequency_sd=found.frequency_sd,
            damping_ratios=found.damping,
            damping_sd=found.damping_sd,
            shape_sd=shape_sd,
            labels=found.labels,
        )
    except (ValueError, TypeError) as error:
        raise type(error)(f"{found.source}: {error}") from None
    _check_plausible(modal, found.source)
    _refuse_copies(modal, found.source)
    if not real or not modal.is_complex:
        return modal
    _check_phases(modal, found.source)
    return modal.real()


def _named(found: Identified, channels) -> tuple[list[str], list[int]]:
    """Names of the channels, and their columns in the source."""
    if found.shapes is None:
        if channels is not None:
            raise ValueError(
                "`channels` must be left out, got some for frequencies without shapes. Pass `names` with "
                "the shapes."
            )
        return [], []
    count = found.shapes.shape[1]
    own = None if found.channels is None else [name.strip() for name in found.channels]
    if own is not None and len(own) != count:
        raise ValueError(
            f"channels must name the {count} rows of shapes, got {len(own)} names. Correct one of them."
        )
    if isinstance(channels, Mapping):
        places = {} if own is None else {name: index for index, name in enumerate(own)}
        return [str(name) for name in channels], [_column(key, places, count) for key in channels.values()]
    if channels is None:
        return (own if own is not None else [f"channel {k}" for k in range(count)]), list(range(count))
    if isinstance(channels, str) or not isinstance(channels, Sequence | np.ndarray):
        raise TypeError(
            "`channels` must be a sequence of names, or a mapping of names to those in the source, got "
            f"{channels!r}."
        )
    names = [str(name).strip() for name in channels]
    if own is not None:
        return names, find_channels(names, own, "the source")
    if len(names) != count:
        raise ValueError(
            f"`channels` must name all {count} channels of shapes without names, got {len(names)}. Pass a "
            "mapping of names to their numbers (from 0) to take some."
        )
    return names, list(range(count))


def _column(key, places: dict[str, int], count: int) -> int:
    """The place of a channel, by its name or number in the source."""
    if isinstance(key, str) and key.strip() in places:
        return places[key.strip()]
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and 0 <= key < count:
        return int(key)
    what = listed(list(places)) if places else f"0 to {count - 1}, without names"
    raise ValueError(
        f"`channels` must be among those of the source ({what}), got {key!r}. Pass the name or the number "
        "(from 0) of one."
    )


def _check_plausible(modal: ModalData, source: str) -> None:
    """Warn of numbers in what is probably another unit."""
    if modal.damping_ratios is not None and (modal.damping_ratios > DAMPED).any():
        warn_modes(
            f"{source}: a damping ratio of {np.nanmax(modal.damping_ratios):.3g} of critical is implausible. "
            "Name it `damping_percent` if that is a percentage."
        )
    if modal.shapes is not None and modal.shapes.shape[1] > 2:
        sizes = np.sort(np.nan_to_num(np.abs(modal.shapes)), axis=1)
        alone = ALONE if modal.shapes.shape[1] > 3 else 10.0 * ALONE  # of three two may be near a node
        for mode in np.flatnonzero(sizes[:, -1] > alone * sizes[:, -2]):
            warn_modes(
                f"{source}: an entry of {sizes[mode, -1]:.3g} in the shape of {modal.frequencies[mode]:.4g} "
                f"Hz is of another size than the others, up to {sizes[mode, -2]:.3g}. Is its exponent spoilt?"
            )
    if modal.frequency_sd is not None and (modal.frequency_sd > SPREAD * modal.frequencies).any():
        mode = int(np.argmax(modal.frequency_sd / modal.frequencies))
        warn_modes(
            f"{source}: a standard deviation of {modal.frequency_sd[mode]:.3g} Hz for a frequency of "
            f"{modal.frequencies[mode]:.4g} Hz is implausible. State standard deviations in the unit of the "
            "frequencies, not in percent."
        )


def _refuse_copies(modal: ModalData, source: str) -> None:
    """A mode that is there twice, to the last digit, was copied by mistake."""
    if modal.shapes is None or modal.labels is not None:
        return
    rows = {}
    for mode, (frequency, shape) in enumerate(zip(modal.frequencies, modal.shapes, strict=True)):
        first = rows.setdefault((frequency, shape.tobytes()), mode)
        if first != mode and np.count_nonzero(~np.isnan(shape)) > 1:
            raise ValueError(
                f"{source}: each mode must be there once, {first + 1} and {mode + 1} of {frequency:.4g} Hz "
                "are identical. Leave one out, or name the mode of each identification in a column `mode`."
            )


def _check_phases(modal: ModalData, source: str) -> None:
    """Warn of shapes whose real part is not all of them."""
    collinearity = modal.phase_collinearity
    low = np.flatnonzero(collinearity < COLLINEAR)
    if low.size:
        modes = ", ".join(f"{modal.frequencies[k]:.4g} Hz: {collinearity[k]:.2f}" for k in low[:8])
        warn_modes(
            f"{source}: the phases of some shapes differ (modal phase collinearity of 1 is in phase; "
            f"{modes}), and their imaginary parts are left out. Leave out modes that are noise, or keep "
            "complex shapes by real=False."
        )
