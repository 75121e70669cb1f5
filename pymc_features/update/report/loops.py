"""Loops of a cyclic test: section of the page, and whether the specimen explains them."""

import numpy as np

from pymc_features.update.report.judgement import Verdict

UNEXPLAINED = 0.35  # rms error over measured rms: more is no explanation
ROUGH = 0.1  # the same, worth a word where the error persists from sample to sample
PERSISTS = 0.5  # correlation of the error with that of the sample before
ENERGY = 0.1  # relative error of the dissipated energy that is worth a word


def loops_section(problem) -> dict:
    """Where displacement and force come from, and how large they are."""
    measured = problem.measured
    displacement, force = measured.record.displacement, measured.channels.values[0]
    return {
        "source": f"source: {measured.source}; {force.size} samples",
        "rows": [
            (name, f"{values.min():.4g}", f"{values.max():.4g}")
            for name, values in (("displacement [m]", displacement), ("force [N]", force))
        ],
        "energy": f"{energy(displacement, force):.4g}",
    }


def energy(displacement, force) -> float:
    """Work of a force along its displacement [J], by the trapezoidal rule."""
    return float(np.trapezoid(force, displacement))


def verdict_of_loops(problem, part) -> Verdict:
    """Judge how the median force of a likelihood meets the measured one."""
    displacement = problem.measured.record.displacement
    force = part["observed_data"]["y"].values[0]
    model = part["bands"]["response"].sel(quantile=0.5).values[0]
    error = force - model
    relative = float(np.sqrt((error**2).sum() / (force**2).sum()))
    share = (
        f"it accounts for {100.0 * max(0.0, 1.0 - relative**2):.0f} % of the force (share of the mean square)"
    )
    explains = relative <= UNEXPLAINED
    sentences = [
        f"The specimen explains the loops: {share}."
        if explains
        else f"This specimen does not explain the loops: {share}."
    ]
    done, by_model = energy(displacement, force), energy(displacement, model)
    if abs(by_model / done - 1.0) > ENERGY:
        sentences.append(
            f"The measured loops dissipate {done:.3g} J, those of the model {by_model:.3g} J: their shape is "
            "not that of the law."
        )
    persistence = float((error[1:] * error[:-1]).sum() / (error**2).sum()) if error.any() else 0.0
    if relative > ROUGH and persistence > PERSISTS:
        largest = float(displacement[np.abs(error).argmax()])
        sentences.append(
            "The error is no noise but an error of the model, largest at a displacement of "
            f"{largest:.3g} m. Let more of the specimen be uncertain (degradation, pinching); what is left "
            "then is beyond its law."
        )
    return Verdict(sentences, explains)
