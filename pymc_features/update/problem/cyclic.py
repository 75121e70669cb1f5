"""From the tables of a cyclic test to what a specimen is updated with."""

from pathlib import Path

from pymc_features.io import read_cyclic_test
from pymc_features.update.config.document import Config
from pymc_features.update.problem.channels import Measured, named_key
from pymc_features.update.problem.checks import Checked


def read_cyclic(config: Config, folder: Path) -> Measured:
    """Read displacement and force; files are relative to `folder`.

    Raises
    ------
    ConfigError
        If a file is missing or broken; the message names the key.
    """
    asked = config.cyclic
    names = [asked.files] if isinstance(asked.files, str) else asked.files
    paths = [folder / name for name in names]
    with named_key("cyclic"):
        test, force = read_cyclic_test(
            paths[0] if isinstance(asked.files, str) else paths,
            columns=asked.columns,
            units=asked.units,
            skip=asked.skip,
            wrapped=asked.wrapped,
        )
    source = ", ".join(Path(name).name for name in names)
    return Measured(test, force, test.dt, source, Checked(None, "not checked: there is one"))
