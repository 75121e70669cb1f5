"""The reference that Sphinx builds."""

import sys

import pytest
from sphinx.util.inventory import InventoryFile

import pymc_features
from support.commands import ROOT, run


@pytest.mark.processes
def test_reference_is_built_without_warnings(tmp_path):
    """And holds every public name; one that it holds twice is a warning."""
    command = (sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees"))
    run(*command, str(ROOT / "docs"), str(tmp_path / "html"))
    inventory = InventoryFile.loads((tmp_path / "html" / "objects.inv").read_bytes(), uri="")
    shown = {name for kind, names in inventory.data.items() if kind.startswith("py:") for name in names}
    modules = {"datasets", "exceptions", "paper", "signals"}
    assert {f"pymc_features.{name}" for name in set(pymc_features.__all__) - modules} <= shown
    assert {"pymc_features.signals.trim", "pymc_features.update.read_problem"} <= shown
