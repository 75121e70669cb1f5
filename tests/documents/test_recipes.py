"""The recipes of docs/extend.md, followed in a copy of the package."""

import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from support.commands import ROOT, run
from support.pages import script


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


@pytest.mark.processes
def test_recipes_can_be_followed(tmp_path):
    """Each new file and line in a copy of the package; the uses of what they add; and the style."""
    page = ROOT / "docs" / "extend.md"
    shutil.copytree(ROOT / "pymc_features", tmp_path / "pymc_features")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    assert len(follow(page, tmp_path)) == 7
    uses = f"import pymc_features; assert pymc_features.__file__.startswith({str(tmp_path)!r})\n"
    run(
        *(sys.executable, "-c", uses + script(page, "python use")),
        env=os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=tmp_path,
    )
    for arguments in (["check"], ["format", "--check"]):
        run(sys.executable, "-m", "ruff", *arguments, "--no-cache", str(tmp_path))
