"""README, pages, recipes, reference, notebooks and style are part of the tests."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from sphinx.util.inventory import InventoryFile

import pymc_features

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").glob("*.md"))
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def run(*command, **options):
    """Output of a command; a test fails with what it complained of."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def blocks(path: Path, kind: str) -> list[str]:
    """Blocks of code of a page."""
    return re.findall(rf"^```{kind}\n(.*?)^```", path.read_text(), flags=re.DOTALL | re.MULTILINE)


def script(path: Path, kind: str = "python") -> str:
    """The blocks of a page as one script, with fewer draws, in one process."""
    code = "\n".join(blocks(path, kind))
    for ours, theirs in (
        ("chains=2", "chains=2, cores=1, progressbar=False"),
        ("sample_nuts(1000", "sample_nuts(300"),
    ):
        code = code.replace(ours, theirs)
    return code


def from_docs(name: str):
    """A module of docs/."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_code_of_readme_and_pages_runs():
    """Each page goes on from the README, in one process."""
    model, expected = blocks(README, "python")
    assert len([line for line in model.splitlines() if line.strip()]) <= 15
    assert expected.count("assert_allclose") == 2
    pages = {path.name: script(path) for path in (README, *PAGES)}
    assert sum(bool(code) for code in pages.values()) >= 5
    code = (
        "import json, sys; pages = json.load(sys.stdin); readme = {}; exec(pages.pop('README.md'), readme)\n"
        "for name, page in pages.items(): exec(compile(page, name, 'exec'), dict(readme))"
    )
    run(sys.executable, "-c", code, input=json.dumps(pages))


def test_ci_calls_the_command_of_the_readme():
    command = "python -m pip install uv && python -m uv run pytest"
    assert f"\n{command}\n" in README.read_text()
    assert f"\n{command}\n" in (ROOT / ".ci" / "run").read_text()


def test_files_that_the_readme_names_exist():
    named = re.findall(r"\]\((?!http)([^)#]+)\)", README.read_text())
    assert "docs/figure.svg" in named
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_tables_of_the_readme_are_those_of_the_catalogues():
    text = README.read_text()
    assert text == from_docs("tables").with_tables(text), "run `python docs/tables.py`"


def test_the_figure_can_be_drawn_anew(tmp_path):
    """From a short record; that of the README is of El Centro and takes ten seconds."""
    record = pymc_features.synthetic_earthquake(4.0, 0.02, random_seed=1, pga=3.0)
    from_docs("figure").write(tmp_path / "figure.svg", record, multipliers=(0.5, 1.0, 2.0))
    assert (tmp_path / "figure.svg").read_text().startswith("<?xml")
    assert (ROOT / "docs" / "figure.svg").stat().st_size < 200_000


def follow(page: Path, folder: Path) -> list[Path]:
    """Write the files of the recipes into a copy of the package, and change the lines they say."""
    written = []
    for path, code in re.findall(r"```python file=(\S+)\n(.*?)```", page.read_text(), flags=re.DOTALL):
        written.append(folder / path)
        written[-1].write_text(code)
    for path, diff in re.findall(r"`(\S+)`\n\n```diff\n(.*?)```", page.read_text(), flags=re.DOTALL):
        text = (folder / path).read_text()
        for hunk in diff.split("@@\n"):
            old, new = (
                "".join(f"{line[1:]}\n" for line in hunk.splitlines() if line[0] in kinds)
                for kinds in (" -", " +")
            )
            assert text.count(old) == 1, f"docs/extend.md: {path} has no lines\n{old}"
            text = text.replace(old, new)
        (folder / path).write_text(text)
    return written


def test_recipes_can_be_followed(tmp_path):
    """Each new file and line in a copy of the package; the uses of what they add; and the style."""
    page = ROOT / "docs" / "extend.md"
    shutil.copytree(ROOT / "pymc_features", tmp_path / "pymc_features")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    assert len(follow(page, tmp_path)) == 7
    uses = f"import pymc_features; assert pymc_features.__file__.startswith({str(tmp_path)!r})\n"
    run(
        *(sys.executable, "-c", uses + script(page, "python use")),
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
    )
    for arguments in (["check"], ["format", "--check"]):
        run(sys.executable, "-m", "ruff", *arguments, "--no-cache", str(tmp_path))


def test_reference_is_built_without_warnings(tmp_path):
    """And holds every public name; one that it holds twice is a warning."""
    command = (sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees"))
    run(*command, str(ROOT / "docs"), str(tmp_path / "html"))
    inventory = InventoryFile.loads((tmp_path / "html" / "objects.inv").read_bytes(), uri="")
    shown = {name for kind, names in inventory.data.items() if kind.startswith("py:") for name in names}
    modules = {"datasets", "exceptions", "paper", "signals"}
    assert {f"pymc_features.{name}" for name in set(pymc_features.__all__) - modules} <= shown
    assert {"pymc_features.signals.trim", "pymc_features.update.read_problem"} <= shown


def test_notebooks_are_numbered_and_ask_a_question():
    numbers = [int(path.name.split("_")[0]) for path in NOTEBOOKS]
    assert len(set(numbers)) == len(numbers) > 0
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        assert re.match(r"# .+\?(\n|$)", cells[0].source), f"{path.name}: the title is no question"
        assert "assert" in [cell.source for cell in cells if cell.cell_type == "code"][-1]


def skip_without_measurements():
    """Skip where the shaking table's data are not at hand."""
    for event in ("northridge", "sine1p5"):
        try:
            pymc_features.datasets.mini_shake_table(event)
        except pymc_features.exceptions.DatasetUnavailableError as error:
            pytest.skip(str(error))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.name)
def test_notebook_runs(path, tmp_path):
    """With half the draws that its cell with the tag `parameters` asks for."""
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "commit notebooks without outputs"
    if any("mini_shake_table" in cell.source for cell in notebook.cells):
        skip_without_measurements()
    [cell] = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    [draws] = re.findall(r"^draws = (\d+)", cell.source, flags=re.MULTILINE)
    cell.source = cell.source.replace(f"draws = {draws}", f"draws = {int(draws) // 2}")
    nbformat.write(notebook, tmp_path / path.name)
    # in a process of its own: its client leaves threads behind, and other tests fork
    code = (
        "import sys, nbformat, nbclient; "
        "nbclient.NotebookClient(nbformat.read(sys.argv[1], as_version=4), timeout=300).execute()"
    )
    run(sys.executable, "-c", code, str(tmp_path / path.name))


@pytest.mark.parametrize("arguments", [["check"], ["format", "--check"]], ids=" ".join)
def test_style(arguments):
    run(sys.executable, "-m", "ruff", *arguments, "--no-cache", str(ROOT))
