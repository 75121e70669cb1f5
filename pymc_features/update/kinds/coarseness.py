"""How coarse the sampling of the base is for the modes that a fit uses."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pymc_features.simulators.excitation import refined_request, refinement
from pymc_features.simulators.quantities import rows_of
from pymc_features.simulators.simulate import respond

FINEST = 8  # refinement beside which that of the model is judged
TOO_COARSE = 1.0  # difference over the half-width of the 90 % bands that is more than the fit may claim


class Coarseness(NamedTuple):
    """What a refinement by eight changes of the responses to the base.

    Attributes
    ----------
    share : float
        Highest natural frequency that the record excites, over the sampling rate of the base [-].
    factor : int
        Refinement in the model.
    change : array (sensor,)
        Root mean square of the difference [m/s^2].
    size : array (sensor,)
        Root mean square of the response [m/s^2].
    """

    share: float
    factor: int
    change: np.ndarray
    size: np.ndarray

    @property
    def sentence(self) -> str:
        """One sentence on the sampling of the base."""
        return (
            f"The base is sampled {1.0 / self.share:.3g} times in a period of the highest mode used; "
            f"refining it {FINEST} times changes responses by {100.0 * max(self.change / self.size):.2g} %."
        )


def coarseness(data, problem, values: dict[str, float], frequencies=None) -> Coarseness:
    """What the sampling of the base does to the responses at some values of the priors.

    A record that is taken as straight lines is compared with one that is band-limited. Where
    the frequencies (draw, mode) of the priors are known, no model is built to refine the record as in it.
    """
    structure, record = problem.structure(**values), data.measured.record
    if frequencies is None:
        asked, outputs = data.request(problem)
    else:
        asked, outputs = request_of_draws(data, problem, structure, frequencies)
    rows = rows_of(structure, asked.quantity, asked, outputs).picked
    used = respond(structure, record, asked, rows)
    smooth = replace(record, interpolation="band-limited")
    fine = respond(structure, smooth, asked._replace(factor=FINEST), rows)
    modes = structure.modes(asked.n_modes) if structure.family == "linear" else structure.modes()
    shares = modes.natural_frequencies * record.dt
    change = np.sqrt(((used - fine)[:, data.measured.compared] ** 2).mean(axis=1))
    size = np.sqrt((fine[:, data.measured.compared] ** 2).mean(axis=1))
    return Coarseness(float(shares[shares <= 1.0].max(initial=shares[0])), asked.factor, change, size)


def request_of_draws(data, problem, structure, frequencies):
    """Do as `Histories.request`, for numbers, and frequencies (draw, mode) that are expected."""
    record = data.measured.record
    asked, outputs = data.as_recorded(problem, structure)
    if record.interpolation == "linear":
        return refined_request(structure, record, asked), outputs
    return asked._replace(factor=refinement(frequencies, record.dt)), outputs


def coarse_sampling(data, problem, posterior, response) -> np.ndarray:
    """That change at the posterior's mean over the half-width of the 90 % bands of responses, (sensor,).

    `response` (quantile, sensor, time) has the quantiles 0.05 and 0.95.
    """
    values = {name: float(posterior[name].mean()) for name in problem.structure.names}
    low, high = (response.sel(quantile=q).transpose("sensor", "time").values for q in (0.05, 0.95))
    with np.errstate(divide="ignore", invalid="ignore"):
        return coarseness(data, problem, values).change / (0.5 * np.sqrt(((high - low) ** 2).mean(axis=1)))


def too_coarse(ratios, sensors, interpolation: str) -> list[str]:
    """Sentences where the sampling of the base changes a response by more than its bands are wide."""
    worst = int(np.nan_to_num(ratios).argmax())
    if not ratios[worst] > TOO_COARSE:
        return []
    is_linear = interpolation == "linear"
    advice = 'Set interpolation = "band-limited".' if is_linear else "Measure the base at a higher rate."
    return [
        f"The base is sampled too coarsely: refining it {FINEST} times changes the response of "
        f"{sensors[worst]} by {ratios[worst]:.2g} times the half-width of its 90 % bands. Do not use these "
        f"results. {advice}"
    ]
