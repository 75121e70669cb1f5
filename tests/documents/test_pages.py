"""README and pages: their code runs, their tables and commands are those of the package."""

import importlib.util
import json
import re
import shlex

import numpy as np
import pymc as pm
import pytensor
import pytest

import pymc_features
from pymc_features.update.config.keys import SCHEMA
from support.commands import ROOT
from support.pages import PAGES, README, blocks, script


def from_docs(name: str):
    """A module of docs/."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def readme():
    """The names of the README's code, compiled as users do it."""
    model, expected = blocks(README, "python")
    assert len([line for line in model.splitlines() if line.strip()]) <= 15
    assert expected.count("assert_allclose") == 2
    names = {}
    with pytensor.config.change_flags(mode="Mode"):
        exec(script(README), names)
    return names


@pytest.mark.processes
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("page", [page for page in PAGES if script(page)], ids=lambda page: page.name)
def test_code_of_a_page_runs(page, readme):
    """Each page goes on from the README."""
    exec(compile(script(page), page.name, "exec"), dict(readme))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_nuts_splits_its_chains_where_sample_does_not():
    """As the page on sampling says."""
    pytest.importorskip("nutpie")
    code = "\n".join(blocks(ROOT / "docs" / "sampling.md", "python alone"))
    exec(
        code.replace("chains=2", "chains=2, cores=1, progressbar=False"),
        {"np": np, "pm": pm, "pmf": pymc_features},
    )


def test_ci_calls_the_command_of_the_readme():
    command = "python -m pip install uv && python -m uv run pytest -n auto"
    assert f"\n{command}\n" in README.read_text()
    assert f"\n{command}\n" in (ROOT / ".ci" / "run").read_text()


def keys_of(schema) -> dict:
    """The keys that each table of a schema has; words and limits differ from one pydantic to another."""
    tables = schema["$defs"] | {"": schema}
    return {name: sorted(table.get("properties", {})) for name, table in tables.items()}


def test_files_that_the_readme_names_exist():
    named = re.findall(r"\]\((?!http)([^)#]+)\)", README.read_text())
    assert "docs/report.png" in named
    assert (ROOT / "docs" / "report.png").stat().st_size < 200_000
    assert [path for path in named if not (ROOT / path).exists()] == []


def parts_of_benchmarks() -> dict[str, tuple[str, ...]]:
    """Sections of `python -m benchmarks`, and the names that `--names` may have in some."""
    from benchmarks import coverage, events
    from benchmarks.__main__ import LONG, SECTIONS

    return dict.fromkeys(SECTIONS + LONG, ()) | {"coverage": coverage.NAMES, "events": tuple(events.PARTS)}


def test_benchmarks_and_tests_that_the_pages_name_exist():
    """So that each number beside such a name can be measured again."""
    parts, n_found = parts_of_benchmarks(), 0
    for path in (README, *PAGES):
        text = " ".join(path.read_text().split())
        for file in re.findall(r"`(tests/[^`]*)`", text):
            assert (ROOT / file).exists(), f"{path.name}: there is no {file}"
        for module, line in re.findall(r"python -m (benchmarks(?:\.\w+)?)([^`]*)`", text):
            words = shlex.split(line)
            assert (ROOT / f"{module.replace('.', '/')}.py").exists() or module == "benchmarks"
            section = words[words.index("--only") + 1] if "--only" in words else "evaluation"
            assert section in parts, f"{path.name}: benchmarks has no section {section}"
            if "--names" in words:
                name = words[words.index("--names") + 1]
                assert name in parts[section], f"{path.name}: {section} has no part {name}"
                n_found += 1
    assert n_found >= 20


def test_tables_are_those_of_the_catalogues():
    text = (ROOT / "docs" / "catalogue.md").read_text()
    assert text == from_docs("tables").with_tables(text), "run `python docs/tables.py`"
    page = (ROOT / "docs" / "channels.md").read_text()
    assert page == from_docs("tables").with_formats(page), "run `python docs/tables.py`"
    found, wanted = (keys_of(json.loads(text)) for text in (SCHEMA.read_text(), from_docs("tables").schema()))
    assert found == wanted, "run `python docs/tables.py`"


def test_notebooks_are_listed_by_their_numbers():
    numbers = [path.name.partition("_")[0] for path in from_docs("notebook_list").notebooks()]
    assert numbers == [str(number) for number in range(1, len(numbers) + 1)]


def test_the_figure_can_be_drawn_anew(tmp_path):
    """From a short record; that of the page is of El Centro and takes ten seconds."""
    record = pymc_features.synthetic_earthquake(4.0, 0.02, random_seed=1, pga=3.0)
    from_docs("figure").write(tmp_path / "figure.svg", record, multipliers=(0.5, 1.0, 2.0))
    assert (tmp_path / "figure.svg").read_text().startswith("<?xml")
    assert (ROOT / "docs" / "figure.svg").stat().st_size < 200_000


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_pictures_of_the_gallery_can_be_drawn(tmp_path):
    """Three of them: of data, of a structure, and of a posterior; all are drawn when the pages are built."""
    gallery = from_docs("gallery")
    assert len(gallery.PICTURES) >= 20
    for file in gallery.draw(tmp_path, ["channels", "mac", "forest"]):
        assert file.stat().st_size > 5_000
        assert f"{file.stem}.png" in gallery.entry(file.stem)
    assert "azp.plot_forest(example.idata" in gallery.entry("forest")
