"""What may be sampled: the likelihoods of responses, and that of identified modes alone."""

from pymc_features.likelihoods import LIKELIHOODS, Likelihood


def nothing(given):
    """No responses are compared."""


MODAL = Likelihood(
    "MODAL",
    "errors of ln f Gaussian, 1 - MAC as the feature of Eq. (3), modes matched at every evaluation",
    "C9",
    nothing,
    takes=(),
)
#: By name. The place of one is part of its seed.
KINDS = LIKELIHOODS | {MODAL.name: MODAL}
