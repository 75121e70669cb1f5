"""The spectra of ambient vibration: figure, section of the page, and whether the model explains them."""

import numpy as np

from pymc_features import plots
from pymc_features.update.report.judgement import Verdict

CERTAIN = 6.0  # standard deviations of a part of a band off
APART = 5.0  # standard deviations between an identified frequency and that of the model
MUCH = 1.5  # factor of the power that is worth a word


def draw_spectra(problem, fitted=None):
    """Figure of the singular values, perhaps with those of the fitted model."""
    ambient = problem.ambient
    identified = None if problem.modal is None else problem.modal.data.frequencies
    return plots.plot_singular_values(ambient.channels, ambient.bands, frequencies=identified, fitted=fitted)


def ambient_section(problem) -> dict:
    """The channels, what was done to them, and the bands."""
    ambient, asked = problem.ambient, problem.config.processing
    steps = [f"source: {ambient.source}"]
    if asked.detrend is not None:
        steps.append(f"less the {asked.detrend.kind} trend")
    if asked.trim is not None:
        steps.append(f"window {asked.trim[0]:g} to {asked.trim[1]:g} s")
    named = zip(ambient.channels["sensor"].values, problem.dofs, ambient.channels.values, strict=True)
    return {
        "steps": steps,
        "rate": f"{ambient.channels.sizes['time']} samples at {ambient.step:.6g} s",
        "bands": ", ".join(f"{low:.4g} to {high:.4g} Hz" for low, high in ambient.bands),
        "proposed": problem.config.ambient.bands == "auto",
        "sensors": [
            (name, dof, f"{np.abs(values).max():.4g}", f"{np.sqrt((values**2).mean()):.4g}")
            for name, dof, values in named
        ],
    }


def verdict_of_spectra(fitted, modes, sd) -> Verdict:
    """Judge how a model meets the spectra.

    Parameters
    ----------
    fitted : Dataset
        From `fitted_spectra`.
    modes : list of ModeRow
        Identified modes and those of the model.
    sd : array
        Standard deviations of the identified frequencies [Hz].
    """
    by_parts = verdict_of_parts(fitted)
    off = [row.deviation(error) for row, error in zip(modes, sd, strict=True)]
    beside = [(abs(z), row) for z, row in zip(off, modes, strict=True) if abs(z) > APART and row.has_partner]
    if not beside:
        return by_parts
    worst, row = max(beside)
    sentence = (
        f"The identified mode {row.name} lies {worst:.0f} standard deviations from that of the model: the "
        "structure cannot have these frequencies together, and the intervals, which take it for right, are "
        "too narrow. Let more of it be uncertain."
    )
    return Verdict([*by_parts.sentences, sentence], False)


def verdict_of_parts(fitted) -> Verdict:
    """Judge the power in each part of the bands."""
    ratio, sd = fitted["ratio"].values, fitted["sd"].values
    more = (ratio > MUCH) & (ratio - 1.0 > CERTAIN * sd)
    less = (ratio < 1.0 / MUCH) & (1.0 - ratio > CERTAIN * sd)
    ends = zip(fitted["low"].values, fitted["high"].values, strict=True)
    places, n = [f"{low:.4g} to {high:.4g} Hz" for low, high in ends], len(ratio)
    if not (more | less).any():
        where = f"all {n} parts of the bands" if n > 1 else "its band"
        return Verdict([f"The power of the channels is what the model expects in {where}."], True)
    wrong = (more | less).sum()
    sentences = [
        f"The power of the channels is not what the model expects in {wrong} of {n} parts of the bands."
    ]
    if more.any():
        worst = int(np.argmax(np.where(more, ratio, 0.0)))
        sentences.append(
            f"The channels have up to {ratio[worst]:.2g} times the power that it expects, most at "
            f"{places[worst]}: a mode, a direction or a machine may be missing, or a force that is not white."
        )
    if less.any():
        worst = int(np.argmin(np.where(less, ratio, np.inf)))
        sentences.append(
            f"They have down to {ratio[worst]:.2g} of the power that it expects, most at {places[worst]}: "
            "forces or errors may differ from band to band. Give them a value for each."
        )
    return Verdict(sentences, False)
