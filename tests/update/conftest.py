"""The example that tests of `update` begin with; figures, drawn only where a test looks at them."""

import pytest
from matplotlib.figure import Figure

from pymc_features.update import write_example
from support.blank_figures import blank
from support.update_files import SMALL, replaced


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The example with simulated data, few draws of EXP and ABC."""
    path = tmp_path_factory.mktemp("update") / "frame.toml"
    write_example(path, synthetic=True)
    path.write_text(replaced(path.read_text(), SMALL))
    return path


@pytest.fixture(scope="module")
def blank_module():
    """For fixtures of a module whose figures nobody looks at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", blank)
        yield


@pytest.fixture
def drawn():
    """For tests that look at the figures which they write."""


@pytest.fixture(autouse=True)
def blank_figures(request, monkeypatch):
    """Figures are made, but their files are empty: to draw them is half of a run.

    Fixtures of wider scope draw theirs, one run of each kind of data, and tests that ask for `drawn`.
    """
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", blank)
