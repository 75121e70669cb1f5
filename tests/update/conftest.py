"""The example that tests of `update` begin with."""

import pytest

from pymc_features.update import write_example
from support.update_files import SMALL, replaced


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The example with simulated data, few draws of EXP and ABC."""
    path = tmp_path_factory.mktemp("update") / "frame.toml"
    paths, sentence = write_example(path, synthetic=True)
    assert paths == [path, path.with_name("frame-measured.csv"), path.with_name("frame.schema.json")]
    assert sentence == "data: simulated, in frame-measured.csv, as asked"
    path.write_text(replaced(path.read_text(), SMALL))
    return path
