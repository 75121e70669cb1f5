"""What is published: wheel and source distribution, built from the repository and opened."""

import ast
import os
import shutil
import site
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.metadata import Metadata
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import pymc_features
from pymc_features import cli
from support.commands import ROOT, run

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
STEM = f"pymc_features-{PROJECT['version']}"
DATA = {
    "pymc_features/py.typed",
    "pymc_features/data/elcentro.dat",
    "pymc_features/update/templates/building.toml",
    *(f"pymc_features/update/templates/{name}" for name in ("figures.js", "report.css", "report.html")),
    *(f"pymc_features/update/templates/{name}" for name in ("report.js", "shapes.js")),
    "pymc_features/update/templates/shaking_table.toml",
}

#: What users have beside the package, in one environment.
NEIGHBOURS = (
    *("bambi", "blackjax", "npTDMS", "numpyro", "nutpie", "obspy", "openseespy", "pymc-extras"),
    *("pymc-marketing", "pyOMA_2", "pyuff", "pyyeti"),
)

# keys of the Citation File Format 1.2.0, and which of them must be there
CITATION_REQUIRED = {"cff-version", "message", "title", "authors"}
CITATION_KEYS = CITATION_REQUIRED | {
    *("abstract", "commit", "contact", "date-released", "doi", "identifiers", "keywords", "license"),
    *("license-url", "preferred-citation", "references", "repository", "repository-artifact"),
    *("repository-code", "type", "url", "version"),
}


def build(source: Path, folder: Path, *kinds: str) -> None:
    """Build distributions of these kinds without a network."""
    targets = [word for kind in kinds for word in ("-t", kind)]
    run(sys.executable, "-m", "hatchling", "build", "-d", str(folder), *targets, cwd=source)


def source_files(*folders: str) -> set[str]:
    """Files of the repository below some folders, but for what Python and the tools leave there."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    left = {"__pycache__", "_build", ".ipynb_checkpoints", ".pytest_cache", ".ruff_cache"}
    return {path.relative_to(ROOT).as_posix() for path in paths if not left & set(path.parts)}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with both distributions of the repository."""
    folder = tmp_path_factory.mktemp("dist")
    build(ROOT, folder, "sdist", "wheel")
    assert {path.name for path in folder.iterdir()} == {f"{STEM}.tar.gz", f"{STEM}-py3-none-any.whl"}
    return folder


@pytest.fixture(scope="module")
def wheel(built):
    return built / f"{STEM}-py3-none-any.whl"


@pytest.mark.processes
def test_wheel_holds_the_package_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as opened:
        names = set(opened.namelist())
    package = {name for name in names if not name.startswith(f"{STEM}.dist-info/")}
    assert package == source_files("pymc_features")
    assert package >= DATA
    about = {name.partition("/")[2] for name in names - package}
    assert about == {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}


@pytest.mark.processes
def test_metadata_of_the_wheel(wheel):
    """Dependencies, extras, script and classifiers are those of pyproject.toml, and valid."""
    with zipfile.ZipFile(wheel) as opened:
        metadata = Metadata.from_email(opened.read(f"{STEM}.dist-info/METADATA"), validate=True)
        scripts = opened.read(f"{STEM}.dist-info/entry_points.txt").decode()
    extras = PROJECT["optional-dependencies"]
    wanted = {Requirement(entry) for entry in PROJECT["dependencies"]}
    wanted |= {
        Requirement(f"{entry}; extra == {extra!r}") for extra, names in extras.items() for entry in names
    }
    assert set(metadata.requires_dist) == wanted
    assert set(metadata.provides_extra) == set(extras)
    assert metadata.requires_python == SpecifierSet(PROJECT["requires-python"])
    assert (metadata.license_expression, metadata.license_files) == ("Apache-2.0", ["LICENSE"])
    assert metadata.description == (ROOT / "README.md").read_text()
    assert "pymc-features = pymc_features.cli:command" in scripts.splitlines()


def test_the_version_is_that_of_the_distribution(capsys):
    assert pymc_features.__version__ == PROJECT["version"]
    with pytest.raises(SystemExit, match="^0$"):
        cli.main(["--version"])
    assert capsys.readouterr().out == f"pymc-features {PROJECT['version']}\n"


def test_classifiers_name_the_versions_of_python_that_are_allowed():
    versions = [c.rpartition(":: ")[2] for c in PROJECT["classifiers"] if "Python :: 3." in c]
    allowed = SpecifierSet(PROJECT["requires-python"])
    assert versions == ["3.12", "3.13", "3.14"]
    assert all(version in allowed for version in versions)
    assert "3.11" not in allowed


@pytest.mark.processes
def test_source_distribution_builds_the_same_wheel(built, wheel, tmp_path):
    """Byte by byte; and it holds the tests, the pages and what they need."""
    with tarfile.open(built / f"{STEM}.tar.gz") as opened:
        opened.extractall(tmp_path, filter="data")
    source = tmp_path / STEM
    held = {path.relative_to(source).as_posix() for path in source.rglob("*") if path.is_file()}
    folders = ("pymc_features", "tests", "docs", "notebooks", "benchmarks", ".ci")
    assert held >= source_files(*folders)
    more = {name for name in held if name.partition("/")[0] not in folders}
    assert more == {"CITATION.cff", "LICENSE", "README.md", "pyproject.toml", ".gitignore", "PKG-INFO"}
    build(source, tmp_path, "wheel")
    assert (tmp_path / wheel.name).read_bytes() == wheel.read_bytes()


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A clean virtual environment with the wheel, which finds the dependencies where they are now."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", str(folder))
    binaries = folder / ("Scripts" if os.name == "nt" else "bin")
    python = str(binaries / "python")
    packages = Path(run(python, "-c", "import site; print(site.getsitepackages()[-1])").strip())
    (packages / "dependencies.pth").write_text("".join(f"{path}\n" for path in site.getsitepackages()))
    run(python, "-m", "installer", "--no-compile-bytecode", str(wheel))
    return binaries


@pytest.mark.processes
def test_installed_wheel_works(installed, tmp_path):
    """It is imported from where it was installed, finds its data, and has its command."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    code = (
        "import pymc_features as pmf\n"
        "from pymc_features.update.templates import TEMPLATES\n"
        "print(pmf.__file__)\n"
        "print(pmf.datasets.el_centro())\n"
        "print(sorted(TEMPLATES.list_templates()))"
    )
    python, command = str(installed / "python"), shutil.which("pymc-features", path=str(installed))
    place, record, templates = run(python, "-c", code, cwd=tmp_path, env=environment).splitlines()
    assert Path(place).is_relative_to(installed.parent)
    assert record.startswith("Record('El Centro 1940 NS', 1559 samples")
    assert {"building.toml", "report.html", "report.js", "shaking_table.toml"} <= set(
        ast.literal_eval(templates)
    )
    assert "reproduce" in run(command, "--help", cwd=tmp_path, env=environment)


@pytest.mark.processes
@pytest.mark.parametrize("version", ["3.12", "3.13"])
def test_neighbours_have_one_environment_with_the_package(version, tmp_path):
    """None of them asks for what the package, or another of them, cannot have."""
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("there is no uv to resolve versions")
    asked = tmp_path / "asked.txt"
    asked.write_text("\n".join([*NEIGHBOURS, str(ROOT)]))
    command = uv, "pip", "compile", "--quiet", "--python-version", version, str(asked)
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    if done.returncode == 127:
        pytest.skip("there is no uv for this Python")
    if "error sending request" in done.stderr or "dns error" in done.stderr:
        pytest.skip("the package index cannot be reached")
    assert done.returncode == 0, done.stderr
    found = {
        line.partition("==")[0].lower().replace("_", "-") for line in done.stdout.splitlines() if "==" in line
    }
    assert {name.lower().replace("_", "-") for name in NEIGHBOURS} <= found


def test_citation_is_valid_and_of_this_version():
    """By the schema of the Citation File Format 1.2.0, as far as its keys are used."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert CITATION_REQUIRED <= set(citation) <= CITATION_KEYS
    assert citation["type"] in ("software", "dataset")
    assert (citation["version"], citation["license"]) == (PROJECT["version"], PROJECT["license"])
    for work in (citation, *citation["references"]):
        assert {"type", "title", "authors"} <= set(work)
        assert work["authors"]
        assert all("name" in author or "family-names" in author for author in work["authors"])
    assert citation["keywords"] == PROJECT["keywords"]


def test_changelog_begins_with_this_version():
    """Or with what is not yet released; headings after Keep a Changelog."""
    lines = (ROOT / "docs" / "changelog.md").read_text().splitlines()
    versions = [line.removeprefix("## ") for line in lines if line.startswith("## ")]
    assert versions[versions[0] == "Unreleased"].split()[0] == PROJECT["version"]
    kinds = {line.removeprefix("### ") for line in lines if line.startswith("### ")}
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
