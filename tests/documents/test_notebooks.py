"""Each notebook asks a question, runs, and its assertions hold."""

import gc
import multiprocessing
import os
import re
import sys
import traceback

import nbformat
import pytest

import pymc_features
from support.commands import GARBAGE, ROOT

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


def run_cells(sources, folder, errors):
    """Run cells as IPython does, and send the first error, or an empty string."""
    import pytensor
    from IPython.core.interactiveshell import InteractiveShell

    os.chdir(folder)
    sys.modules["pymc_features.inference.sample"].cross_checked = lambda idata, *_: idata
    gc.freeze()  # what is imported stays
    gc.set_threshold(*GARBAGE)
    pytensor.config.mode = "FAST_COMPILE"
    shell = InteractiveShell.instance()
    for source in sources:
        result = shell.run_cell(source)
        error = result.error_before_exec or result.error_in_exec  # what is no Python, or raises
        if error is not None:
            errors.send(f"{source}\n{''.join(traceback.format_exception(error))}")
            return
    errors.send("")


@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.name)
def test_notebook_runs(path, tmp_path):
    """With half the draws that its cell with the tag `parameters` asks for, of many an eighth.

    Without machine code of PyTensor's: the kernels do the work, and the rest takes longer to compile.
    Without the check behind each run of `sample`, which has tests of its own. Each in a process of its
    own, forked from one that has imported what they need.
    """
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "commit notebooks without outputs"
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    skip_without_measurements("".join(cell.source for cell in cells))
    [cell] = [cell for cell in cells if "parameters" in cell.metadata.get("tags", [])]
    [draws] = re.findall(r"^draws = (\d+)", cell.source, flags=re.MULTILINE)
    fewer = int(draws) // (2 if int(draws) < 1000 else 8)
    cell.source = cell.source.replace(f"draws = {draws}", f"draws = {fewer}")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pymc_features.public", "IPython.core.interactiveshell"])
    received, errors = context.Pipe(duplex=False)
    process = context.Process(target=run_cells, args=([cell.source for cell in cells], tmp_path, errors))
    process.start()
    errors.close()
    try:
        said = received.recv() if received.poll(300.0) else "still running after 300 s"
    except EOFError:
        said = "the process has ended"
    if said:
        process.terminate()
    process.join()
    assert said == ""
