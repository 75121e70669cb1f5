"""The README and the pages of docs/, and their blocks of code."""

import re
from importlib.util import find_spec
from pathlib import Path

from support.commands import ROOT

README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").glob("*.md"))


def blocks(path: Path, kind: str) -> list[str]:
    """Blocks of code of a page."""
    return re.findall(rf"^```{kind}\n(.*?)^```", path.read_text(), flags=re.DOTALL | re.MULTILINE)


def sections(path: Path) -> list[tuple[str, str]]:
    """Kind and content of all blocks of code of a page, in their order."""
    return re.findall(r"^```([^{\n][^\n]*)\n(.*?)^```", path.read_text(), flags=re.DOTALL | re.MULTILINE)


def can_run(found: str, kind: str) -> bool:
    """Whether a block of this kind needs a library, which is installed."""
    start, _, library = found.partition(" needs=")
    return start == kind and library != "" and find_spec(library) is not None


def script(path: Path, kind: str = "python") -> str:
    """The blocks of a page as one script, with fewer draws, chains and processes.

    Those that need another library (`python needs=pyoma2`) only where it is installed.
    """
    code = "\n".join(content for found, content in sections(path) if found == kind or can_run(found, kind))
    for ours, theirs in (
        ("chains=2", f"chains={2 if path == README else 1}, cores=1, progressbar=False"),
        ("sample_nuts(1000", "sample_nuts(100, tune=50, chains=2, cores=1, progressbar=False"),
        ("timeout=60.0, executor=2", "timeout=60.0, executor=1"),
    ):
        code = code.replace(ours, theirs)
    return code
