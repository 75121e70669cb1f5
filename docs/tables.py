"""The tables of the README, from the catalogues: `python docs/tables.py` writes them.

A row is a member of a catalogue, its file, and the first sentence of its docstring.
"""

import inspect
import re
from pathlib import Path

from pymc_features.distributions import LIKELIHOODS
from pymc_features.inference import sample
from pymc_features.likelihood_free import NODES
from pymc_features.smc import KERNELS, SIMULATOR_KERNELS
from pymc_features.structures import DAMPINGS, STRUCTURES

ROOT = Path(__file__).resolve().parents[1]
TABLES = {  # name between the markers -> heading of the first column, members
    "structures": ("structure or damping", STRUCTURES + DAMPINGS),
    "likelihoods": ("likelihood or node", LIKELIHOODS + NODES),
    "kernels": ("sampler or kernel", (sample, *KERNELS, *SIMULATOR_KERNELS)),
}


def first_sentence(member) -> str:
    """First sentence of a docstring, fit for a cell."""
    paragraph = " ".join(inspect.getdoc(member).split("\n\n")[0].split())
    return re.split(r"(?<=[.])\s+(?=[A-Z])", paragraph)[0].rstrip(".").replace("|", r"\|")


def table(name: str) -> str:
    """One table in Markdown."""
    heading, members = TABLES[name]
    rows = [f"| {heading} | what it is |", "|---|---|"]
    for member in members:
        path = "/".join(member.__module__.split(".")) + ".py"
        rows.append(f"| [`{member.__name__}`]({path}) | {first_sentence(member)} |")
    return "\n".join(rows) + "\n"


def with_tables(text: str) -> str:
    """The README with every table written anew between its markers."""
    for name in TABLES:
        pattern = rf"(<!-- table: {name} -->\n).*?(<!-- end of table -->)"
        text, found = re.subn(pattern, lambda m, n=name: m[1] + table(n) + m[2], text, flags=re.DOTALL)
        if found != 1:
            raise ValueError(f"README.md must have one table `{name}` between its markers, got {found}.")
    return text


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(with_tables(readme.read_text()))
