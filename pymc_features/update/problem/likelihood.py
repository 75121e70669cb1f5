"""Whether the section [likelihood] fits the data and the priors."""

from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.update.config.entries import Parameter
from pymc_features.update.config.sections import ERRORS


def check_gaps(config, measured) -> None:
    """Likelihoods that compare neighbouring samples take no gaps."""
    whole = [kind for kind in config.likelihood.kinds if not LIKELIHOODS[kind].takes_gaps]
    if whole and measured.left_out:
        raise ConfigError(
            f"`likelihood.kinds` must not have {whole[0]} where samples are missing, got gaps of "
            f"{measured.left_out}: it compares neighbouring samples. Compare a part "
            "without gaps by `processing.compare`, leave out the sensor, or take "
            f"{', '.join(kind for kind, entry in LIKELIHOODS.items() if entry.takes_gaps)}."
        )


def check_errors(config, priors, n_sensors: int) -> None:
    """One positive value, or one for each sensor; the sigma that ABC takes from EXP must be one."""
    likelihood = config.likelihood
    for name, unit in ERRORS.items():
        given = getattr(likelihood, name)
        if isinstance(given, list) and len(given) != n_sensors:
            raise ConfigError(
                f"`likelihood.{name}` must be one value or one for each of the {n_sensors} sensors, got "
                f"{len(given)}."
            )
        for value in given if isinstance(given, list) else [given]:
            if isinstance(value, float) and value <= 0.0:
                advice = f"Pass it in {unit}." if unit != "-" else "1 is that of TN, 2 that of EXP."
                raise ConfigError(f"`likelihood.{name}` must be positive, got {value:g}. {advice}")
            if isinstance(value, Parameter) and (middle := priors[value.prior].median) <= 0.0:
                raise ConfigError(
                    f"`likelihood.{name}` must be positive, got the prior `priors.{value.prior}` with the "
                    f"median {middle:g}. Take a distribution of positive numbers."
                )
    if "ABC" in likelihood.kinds and config.processing.compare is not None:
        raise ConfigError(
            "`likelihood.kinds` must not have ABC with `processing.compare`, for it compares whole "
            "responses. Leave one of them out."
        )
    if "ABC" in likelihood.kinds and likelihood.epsilon is None and isinstance(likelihood.sigma, list):
        raise ConfigError(
            "`likelihood.epsilon` must be given for ABC where each sensor has its own sigma, got none."
        )
