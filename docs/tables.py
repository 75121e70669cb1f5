"""The tables of catalogue.md and of channels.md, and the schema of update.toml: `python docs/tables.py`.

A row is a member of a catalogue, its file, and the first sentence of its docstring; or a format of files, how
they are called, and what they state.
"""

import inspect
import json
import re
from pathlib import Path

import pymc_features
from pymc_features.ambient import AmbientResponse
from pymc_features.inference import sample
from pymc_features.io import FORMATS
from pymc_features.likelihoods import HISTORY_LIKELIHOODS, NODES
from pymc_features.modal import FrequencyResponse, ModalFeature
from pymc_features.smc import KERNELS, SIMULATOR_KERNELS
from pymc_features.structures import DAMPINGS, STRUCTURES
from pymc_features.structures.specimens import SPECIMENS
from pymc_features.update.config.keys import SCHEMA
from pymc_features.update.problem import Config

ROOT = Path(__file__).resolve().parents[1]
TABLES = {  # name between the markers -> heading of the first column, members
    "structures": ("structure or damping", STRUCTURES + SPECIMENS + DAMPINGS),
    "likelihoods": (
        "likelihood or node",
        (*HISTORY_LIKELIHOODS, ModalFeature, FrequencyResponse, AmbientResponse, *NODES),
    ),
    "kernels": ("sampler or kernel", (sample, *KERNELS, *SIMULATOR_KERNELS)),
}


def first_sentence(member) -> str:
    """First sentence of a docstring, fit for a cell."""
    paragraph = " ".join(inspect.getdoc(member).split("\n\n")[0].split())
    return re.split(r"(?<=[.])\s+(?=[A-Z])", paragraph)[0].rstrip(".").replace("|", r"\|")


def called(member) -> str:
    """How a member is called in `pymc_features`: by its name, or in the submodule that has it."""
    name = member.__name__
    if name in pymc_features.__all__:
        return name
    modules = (m for m in pymc_features.__all__ if inspect.ismodule(getattr(pymc_features, m)))
    return next(f"{m}.{name}" for m in modules if name in dir(getattr(pymc_features, m)))


def table(name: str) -> str:
    """One table in Markdown."""
    heading, members = TABLES[name]
    rows = [f"| {heading} | what it is |", "|---|---|"]
    for member in members:
        path = "../" + "/".join(member.__module__.split(".")) + ".py"
        rows.append(f"| [`{called(member)}`]({path}) | {first_sentence(member)} |")
    return "\n".join(rows) + "\n"


def formats() -> str:
    """The formats of record files in Markdown."""
    rows = ["| format | files | what is read from the file |", "|---|---|---|"]
    rows += [f"| {entry.name} | {entry.files} | {entry.states} |" for entry in FORMATS]
    return "\n".join(rows) + "\n"


def replaced(text: str, name: str, rows: str) -> str:
    """The text with one table written anew between its markers."""
    pattern = rf"(<!-- table: {name} -->\n).*?(<!-- end of table -->)"
    text, found = re.subn(pattern, lambda m: m[1] + rows + m[2], text, flags=re.DOTALL)
    if found != 1:
        raise ValueError(f"The page must have one table `{name}` between its markers, got {found}.")
    return text


def with_tables(text: str) -> str:
    """catalogue.md with every table written anew."""
    for name in TABLES:
        text = replaced(text, name, table(name))
    return text


def with_formats(text: str) -> str:
    """channels.md with its table written anew."""
    return replaced(text, "formats", formats())


def schema() -> str:
    """The JSON schema of a configuration file."""
    found = Config.model_json_schema() | {"title": "Configuration of pymc-features update"}
    return json.dumps(found, indent=1) + "\n"


if __name__ == "__main__":
    SCHEMA.write_text(schema())
    for name, write in (("catalogue.md", with_tables), ("channels.md", with_formats)):
        page = ROOT / "docs" / name
        page.write_text(write(page.read_text()))
