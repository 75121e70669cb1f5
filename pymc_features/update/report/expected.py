"""What can be seen of the data before anything is sampled."""

import warnings

import numpy as np
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ModalMatchWarning, PredictionWarning
from pymc_features.plots.histories import draw_expected
from pymc_features.prediction import posterior_response
from pymc_features.storage import write_atomically
from pymc_features.update.kinds.ambient import draw_spectra
from pymc_features.update.kinds.channels import base_and_sensors
from pymc_features.update.kinds.coarseness import coarseness
from pymc_features.update.kinds.modal import MODAL, draw_mac, draw_shapes, modes_verdict
from pymc_features.update.kinds.model import MODAL_DRAWS, names_for
from pymc_features.update.kinds.structure import modes_of
from pymc_features.update.plausibility.bands import QUANTILES, prior_bands
from pymc_features.update.report.terminal import gains_table, modes_table

DPI = 120
DRAWS = 200
FIRST = 5  # natural frequencies


def check_data(problem, path) -> list:
    """Draw priors and channels into a file; return what to print: gains, how coarse the base is sampled."""
    measured, gains = problem.measured, problem.measured.checked.gains
    prior = measured.checked.compared.prior
    units = {name: problem.unit(name) for name in problem.priors}
    densities = {name: one.density for name, one in problem.priors.items()}
    write_figure(draw_expected(base_and_sensors(measured), expected_bands(problem), densities, units), path)
    middle = {name: problem.priors[name].median for name in problem.structure.names}
    return [
        *([] if gains is None else [gains_table(gains)]),
        coarseness(problem.first, problem, middle, prior.frequencies).sentence,
    ]


def expected_bands(problem) -> np.ndarray:
    """Quantiles (quantile, sensor, time) of the responses that the priors expect where the sensors are."""
    measured = problem.measured
    prior, record, stride = (
        measured.checked.compared.prior,
        measured.record,
        round(measured.step / measured.record.dt),
    )
    if prior.is_linear:
        found = prior_bands(record.acceleration, record.dt, prior, problem.dofs, problem.first.quantity)
        return found[..., ::stride][..., measured.compared]
    draws = xr.Dataset({name: (("chain", "draw"), values[None]) for name, values in prior.values.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PredictionWarning)
        found = posterior_response(
            draws,
            problem.structure,
            record,
            problem.first.quantity,
            sensors=problem.dofs,
            dt=measured.step,
            draws=DRAWS,
            quantiles=QUANTILES,
        )[problem.first.quantity]
    return found.transpose("quantile", ..., "time").values[..., measured.compared]


def structure_sentence(problem) -> str:
    """Mass and first frequencies of the structure at the medians of the priors."""
    medians = {name: problem.priors[name].median for name in problem.structure.names}
    at_medians = problem.structure(**medians)
    found = modes_of(at_medians, FIRST).natural_frequencies[:FIRST]
    influence = getattr(at_medians, "influence", None)
    moved = np.sum(at_medians.mass if influence is None else influence * (at_medians.mass @ influence))
    numbers = ", ".join(f"{frequency:.4g}" for frequency in found)
    given = problem.config.report.natural_frequencies
    beside = ""
    if given is not None:
        beside = f" (natural_frequencies: {', '.join(f'{frequency:.4g}' for frequency in given)} Hz)"
    return (
        f"structure: {at_medians.n_dof} degrees of freedom, {moved:.4g} kg that the base moves; natural "
        f"frequencies at the medians of the priors: {numbers} Hz{beside}"
    )


def check_loops(problem, path) -> str:
    """Draw measured loops and what the priors expect of them into a file; say how much of it they hold."""
    names = problem.structure.names
    columns = {
        name: (("chain", "draw"), problem.priors[name].draw(DRAWS, k)[None]) for k, name in enumerate(names)
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PredictionWarning)  # priors may reach beyond what a specimen is
        found = posterior_response(
            xr.Dataset(columns), problem.structure, problem.measured.record, "restoring_force", draws=DRAWS
        )
    force = problem.measured.channels
    write_figure(plots.plot_loops(found, measured=force), path)
    low, *_, high = found["restoring_force"].transpose("quantile", "sensor", "time").values
    share = float(np.mean((force.values >= low) & (force.values <= high)))
    return f"{100.0 * share:.0f} % of the measured forces lie within what the priors expect (5 to 95 %)"


def check_spectra(problem, path) -> str:
    """Draw the spectra with the bands into a file; return the line of the file with the bands."""
    write_figure(draw_spectra(problem.ambient), path)
    return problem.ambient.sentence


def check_modes(problem, path) -> tuple:
    """Compare identified modes with those that the priors expect, and draw them into a file.

    Partners are judged by their shapes: frequencies are what is to be updated.

    Returns
    -------
    Table, list of str, bool
        The table, what to think of it, and whether there was anything to draw.
    """
    modal = problem.modal
    draws = expected(problem.with_data(modal))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalMatchWarning)  # the sentences say it
        rows = modal.rows(modal.matched(problem, draws, deviations=np.inf))
    found = modal.shapes(problem, draws)
    is_drawn = "at_channels" in found
    if is_drawn:
        draw = draw_shapes if "at_points" in found else draw_mac
        write_figure(draw(modal, found, rows), path)
    sentences, _ = modes_verdict(rows)
    outside = [row for row in rows if not row.low <= row.measured <= row.high]
    if outside:
        named = ", ".join(f"{row.name} ({row.measured:.4g} Hz)" for row in outside)
        sentences.append(f"Outside of what the priors expect (5 to 95 %): {named}.")
    table = modes_table(rows, "Identified modes [Hz], and the model under the priors")
    return table, sentences, is_drawn


def expected(problem) -> xr.Dataset:
    """Draws of the priors of what decides on modes."""
    values = {
        name: (("chain", "draw"), problem.priors[name].draw(MODAL_DRAWS, k)[None])
        for k, name in enumerate(names_for(problem, MODAL.name))
    }
    return xr.Dataset(values, {"chain": [0], "draw": np.arange(MODAL_DRAWS)})


def write_figure(axes, path) -> None:
    """A figure as a PNG file; it is released."""
    figure = axes[0].get_figure(root=True)
    write_atomically(path, lambda to: figure.savefig(to, dpi=DPI, format="png"))
    plots.close(axes[:1])
