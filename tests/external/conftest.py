"""External simulators that end with the test."""

import pytest

from pymc_features import ExternalSimulator
from support.external_functions import SHAPE, beam


@pytest.fixture
def simulator():
    """Makes simulators with the shape of `beam` on one process, and ends them."""
    made = []

    def make(function=beam, **settings):
        made.append(ExternalSimulator(function, SHAPE, **{"executor": 1, "progress": False, **settings}))
        return made[-1]

    yield make
    for one in made:
        one.close()
