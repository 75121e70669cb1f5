"""The repository's pages: their blocks of code, and commands run on them."""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").glob("*.md"))


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
