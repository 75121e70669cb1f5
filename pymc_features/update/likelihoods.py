"""What may be sampled: the likelihoods of responses, of identified modes alone, and of ambient vibration."""

from pymc_features.likelihoods import LIKELIHOODS, Likelihood


def nothing(given):
    """No response is compared in time."""


MODAL = Likelihood(
    "MODAL",
    "errors of ln f Gaussian, 1 - MAC as the feature of Eq. (3), modes matched at every evaluation",
    "C9",
    nothing,
    takes=(),
)
AMBIENT = Likelihood(
    "AMBIENT",
    "Fourier transforms of the channels complex Gaussian, forces and errors white in each band",
    "C8",
    nothing,
    takes=(),
)
#: By name. The place of one is part of its seed.
KINDS = LIKELIHOODS | {entry.name: entry for entry in (MODAL, AMBIENT)}
