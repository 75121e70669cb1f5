"""Each notebook asks a question, runs, and its assertions hold."""

import os
import re
import sys

import nbformat
import pytest

import pymc_features
from support.commands import ROOT, run

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_notebooks_are_numbered_and_ask_a_question():
    numbers = [int(path.name.split("_")[0]) for path in NOTEBOOKS]
    assert len(set(numbers)) == len(numbers) > 0
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        assert re.match(r"# .+\?(\n|$)", cells[0].source), f"{path.name}: the title is no question"
        assert "assert" in [cell.source for cell in cells if cell.cell_type == "code"][-1]


MEASUREMENTS = [
    ("mini_shake_table", "northridge"),
    ("mini_shake_table", "sine1p5"),
    ("footbridge",),
    ("rc_column",),
]


def skip_without_measurements(source):
    """Skip where data that some code loads are not at hand."""
    for name, *arguments in MEASUREMENTS:
        if f"datasets.{name}" in source:
            try:
                getattr(pymc_features.datasets, name)(*arguments)
            except pymc_features.exceptions.DatasetUnavailableError as error:
                pytest.skip(str(error))


@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.name)
def test_notebook_runs(path, tmp_path):
    """With half the draws that its cell with the tag `parameters` asks for, of many an eighth.

    Without machine code of PyTensor's: the kernels do the work, and the rest takes longer to compile.
    """
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "commit notebooks without outputs"
    skip_without_measurements("".join(cell.source for cell in notebook.cells))
    [cell] = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    [draws] = re.findall(r"^draws = (\d+)", cell.source, flags=re.MULTILINE)
    fewer = int(draws) // (2 if int(draws) < 1000 else 8)
    cell.source = cell.source.replace(f"draws = {draws}", f"draws = {fewer}")
    nbformat.write(notebook, tmp_path / path.name)
    # in a process of its own: its client leaves threads behind, and other tests fork
    code = (
        "import sys, nbformat, nbclient; "
        "nbclient.NotebookClient(nbformat.read(sys.argv[1], as_version=4), timeout=300).execute()"
    )
    flags = ",".join(filter(None, [os.environ.get("PYTENSOR_FLAGS"), "mode=FAST_COMPILE"]))
    run(sys.executable, "-c", code, str(tmp_path / path.name), env=os.environ | {"PYTENSOR_FLAGS": flags})
