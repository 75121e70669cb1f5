"""Identified modes beside those of a model, in rows, and what to think of them."""

from typing import NamedTuple

import numpy as np

from pymc_features.update.presentation.numbers import Scale, fixed
from pymc_features.update.presentation.shown import Verdict

COLUMNS = ("mode", "measured", "5 %", "50 %", "95 %", "off", "MAC", "5-95 %", "partner")
MEANING = (
    "Frequencies in Hz: as measured, and 5, 50 and 95 % of the mode of the model that each is matched with; "
    "how far its median is off; the MAC of the two shapes with its interval; and the number of that mode, f1 "
    "being the lowest. A partner is within three standard deviations of the frequency, and has a "
    "MAC of at least 0.5."
)
MOST = 0.5  # share of the draws without a partner that is said
WIDTH = 3.29  # standard deviations between 5 and 95 % of a normal distribution
ALONE = 0.95  # share of the draws in which a mode takes the same partner


class ModeRow(NamedTuple):
    """One identified mode and its partners in the draws.

    Attributes
    ----------
    name : str
        Its number in the file, and its label.
    measured : float
        [Hz]
    low, middle, high : float
        Of the model [Hz]: 5, 50 and 95 %.
    mac : tuple of float
        5, 50 and 95 %; NaN without a shape.
    partner : int
        Mode of the model that most draws take, 1 the lowest.
    share : float
        Of the draws that take it.
    strangers : float
        Share of the draws in which it has no partner.
    """

    name: str
    measured: float
    low: float
    middle: float
    high: float
    mac: tuple[float, float, float]
    partner: int
    share: float
    strangers: float

    @property
    def off(self) -> float:
        """Median of the model over the measurement, less one."""
        return self.middle / self.measured - 1.0

    def deviation(self, sd: float) -> float:
        """How many standard deviations the median of the model is off, if that of the measurement is `sd`."""
        of_model = (self.high - self.low) / WIDTH
        return (self.middle - self.measured) / float(np.hypot(sd, of_model))

    @property
    def has_partner(self) -> bool:
        """Return whether the mode has a partner in most draws."""
        return self.strangers <= MOST

    @property
    def cells(self) -> tuple[str, ...]:
        """Texts of the row, in the order of `COLUMNS`."""
        values, sd = (self.low, self.middle, self.high), (self.high - self.low) / WIDTH
        numbers = [f"{self.measured:.4g}", *fixed(values, sd, Scale(1.0, "Hz"))]
        low, middle, high = self.mac
        of_shape = ("", "") if np.isnan(middle) else (f"{middle:.3f}", f"{low:.3f}-{high:.3f}")
        partner = f"f{self.partner}" if self.has_partner else "none"
        return self.name, *numbers, f"{100.0 * self.off:+.2f} %", *of_shape, partner


def modes_verdict(rows: list[ModeRow]) -> Verdict:
    """What to think of the fit of identified modes, and whether all have a partner."""
    strangers = [row for row in rows if not row.has_partner]
    with_partner = [row for row in rows if row.has_partner]
    sentences = []
    for row in strangers:
        of_shape = "" if np.isnan(row.mac[1]) else f", MAC {row.mac[1]:.2f}"
        sentences.append(
            f"The model has no partner for the identified mode {row.name} ({row.measured:.4g} Hz): the best "
            f"that is left is at {row.middle:.4g} Hz{of_shape}."
        )
    if with_partner:
        which = (
            "the identified mode"
            if len(rows) == 1
            else f"{len(with_partner)} of {len(rows)} identified modes"
        )
        which = which if strangers or len(rows) == 1 else f"all {len(rows)} identified modes"
        off = max(with_partner, key=lambda row: abs(row.off))
        sentence = (
            f"The model has a partner for {which}: the median frequency is off by at most "
            f"{100.0 * abs(off.off):.2g} % (mode {off.name})"
        )
        shaped = [row for row in with_partner if not np.isnan(row.mac[1])]
        if shaped:
            worst = min(shaped, key=lambda row: row.mac[1])
            sentence += f", the MAC is at least {worst.mac[1]:.3f} (mode {worst.name})"
        sentences.append(f"{sentence}.")
    for row in rows:
        if row.share < ALONE:
            sentences.append(
                f"The identified mode {row.name} takes f{row.partner} in {100.0 * row.share:.0f} % of the "
                "draws, and others in the rest: they change places, or the data cannot tell them apart."
            )
    return Verdict(sentences, not strangers)
