"""The tutorial: who types what the page says, and has nothing else, gets its numbers."""

import re
import runpy

import numpy as np
import pytest
from matplotlib.figure import Figure

from pymc_features import cli
from support.blank_figures import blank
from support.commands import ROOT
from support.pages import sections

PAGE = ROOT / "docs" / "tutorial.md"
NUMBER = re.compile(r"-?\d[\d,]*(?:\.\d+)?")


def numbers(line: str) -> np.ndarray:
    """The numbers of a line."""
    return np.array([float(word.replace(",", "")) for word in NUMBER.findall(line)])


def says(output: str, line: str) -> bool:
    """Whether a line of the output has the words of a line, and its numbers to 2 %."""
    words = NUMBER.sub("#", " ".join(line.split()))
    found = [one for one in output.splitlines() if NUMBER.sub("#", " ".join(one.split())) == words]
    return any(np.allclose(numbers(one), numbers(line), rtol=0.02) for one in found)


def cells(row: str) -> list[str]:
    """Cells of a row of a table."""
    return re.split(r"\s{2,}", row.strip())


def check_table(output: str, page: str) -> None:
    """The output has a table with these columns, and these rows: quantiles to 0.2 %, others to a quarter."""
    heading, *rows = map(cells, page.splitlines())
    printed = [cells(line) for line in output.splitlines()]
    table = {tuple(row[:2]): row for row in printed[printed.index(heading) :]}
    for row in rows:
        theirs = table[tuple(row[:2])]
        assert len(theirs) >= len(row)
        for name, ours, found in zip(heading[2:], row[2:], theirs[2:], strict=False):
            if NUMBER.fullmatch(ours):
                tolerance = {"rtol": 0.002} if "%" in name else {"rtol": 0.25, "atol": 0.05}
                np.testing.assert_allclose(float(found), float(ours), **tolerance)
            else:
                assert found == ours


def typed(command: str, capsys) -> str:
    """What a command of the page says."""
    program, *arguments = command.split()
    if program == "python":
        runpy.run_path(arguments[0])
    else:
        assert (program, cli.main(arguments)) == ("pymc-features", 0)
    captured = capsys.readouterr()
    return captured.out + captured.err


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_tutorial_gives_its_numbers(tmp_path, monkeypatch, capsys):
    """Files, commands, what they say, and Python in the order of the page, in an empty folder."""
    monkeypatch.setattr(Figure, "savefig", blank)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    config, output, names, kinds = tmp_path / "update.toml", "", {}, []
    for kind, content in sections(PAGE):
        kinds.append(kind)
        if " file=" in kind:
            (tmp_path / kind.partition(" file=")[2]).write_text(content)
        elif kind == "toml correction":
            config.write_text(re.sub(r"(dofs = .*\n)", rf"\1{content}", config.read_text()))
            output = typed("pymc-features check update.toml", capsys)
        elif kind == "toml append":
            config.write_text(f"{config.read_text()}\n{content}")
        elif kind == "sh":
            output = typed(content, capsys)
        elif kind == "text":
            for line in content.splitlines():
                assert says(output, line), f"{line}\nis not in\n{output}"
        elif kind == "text table":
            check_table(output, content)
        else:
            assert kind == "python tutorial"
            exec(content, names)
    assert kinds.count("sh") == 4 and kinds.count("python tutorial") == 4
