"""What the sensors can see of each parameter before anything is measured or sampled: [sensitivity]."""

import numpy as np

from pymc_features.exceptions import ConfigError
from pymc_features.inference.fisher import product_function
from pymc_features.inference.parameters import initial_values
from pymc_features.update.config.keys import named_key
from pymc_features.update.kinds import KINDS
from pymc_features.update.kinds.base import declare

BLIND = 0.8  # share of a prior's standard deviation that remains: sensors hardly see the parameter
SPREAD = 2000  # draws from which a prior's standard deviation is known to 2 %


def remaining(problem) -> dict[str, tuple[float, str]]:
    """Judge every parameter of the structure by the Fisher information over the prior.

    At each draw of the priors the posterior covariance is about (I + P)^-1, with I the Fisher information of
    the likelihoods, see `fisher_information`, and P the inverse variances of the priors. Each name has the
    median share of the prior's standard deviation that remains [-], 1 where the data tell nothing, and the
    parameter that is hardest to tell apart from it, where that leaves most of what remains.
    """
    kind = problem.reported[0]
    with named_key("sensitivity"):
        model = declare(problem, KINDS[kind].calibrates or kind)
        function = product_function(model)
    names = [rv.name for rv in model.free_RVs]
    columns = {name: problem.priors[name].draw(SPREAD, k) for k, name in enumerate(names)}
    spread, scaled = np.array([columns[name].std() for name in names]), []
    for i in range(problem.config.sensitivity.draws):
        values = initial_values(model, {name: column[i] for name, column in columns.items()})
        information = np.array([function(*values.values(), row) for row in np.eye(len(names))])
        scaled.append(0.5 * (information + information.T) * np.outer(spread, spread) + np.eye(len(names)))
    scaled = np.array([one for one in scaled if np.isfinite(one).all()])
    if not len(scaled):
        raise ConfigError(
            "[sensitivity]: priors must have draws with a finite response, got none. Narrow them."
        )
    shares = np.sqrt(np.diagonal(np.linalg.inv(scaled), axis1=1, axis2=2))
    covariance = np.linalg.inv(scaled.mean(axis=0))
    scale = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance / np.outer(scale, scale)) - np.eye(len(names))
    found = {}
    for i in (names.index(name) for name in problem.structure.names):
        other = int(correlation[i].argmax())
        together = names[other] if correlation[i, other] > BLIND else ""
        found[names[i]] = float(np.median(shares[:, i])), together
    return found


def sensitivity_sentences(found: dict[str, tuple[float, str]]) -> list[str]:
    """Which parameters these sensors hardly see, and which they cannot tell apart."""
    blind = ", ".join(f"{name} ({100 * share:.0f} %)" for name, (share, _) in found.items() if share > BLIND)
    pairs = {" and ".join(sorted((name, other))) for name, (_, other) in found.items() if other}
    told = []
    if blind:
        told.append(
            f"These sensors can hardly see {blind}, in brackets what they leave of the prior's standard "
            "deviation: fix them, or add sensors."
        )
    if pairs:
        told.append(f"They can hardly tell apart {', '.join(sorted(pairs))}.")
    return told or ["These sensors can see every parameter."]
