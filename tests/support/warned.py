"""Texts of warnings about channels."""

import sys
import warnings

from pymc_features.exceptions import ChannelWarning


def messages(action):
    """Texts of our warnings, which point to the line of the caller; any other warning fails."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        action()
    assert all(warning.category is ChannelWarning for warning in caught), [str(w.message) for w in caught]
    caller = sys._getframe(1).f_code.co_filename
    assert all(warning.filename == caller for warning in caught)
    return [str(warning.message) for warning in caught]
