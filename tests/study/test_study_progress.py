"""What the study says while it runs: one bar, or a line every few seconds where there is no terminal."""

import io

from rich.console import Console

from pymc_features import progress
from pymc_features.progress import PartProgress

PARTS = [
    ("NORM_x0.1", 0),
    ("TN_x0.1", 1),
    ("EXP_x0.1", 2),
    ("ABC_x0.1", 3),
    ("figures", 99),
    ("finished", 100),
]


def test_lines_where_there_is_no_terminal(monkeypatch):
    """Parts of two seconds: a line at the first, then not before three seconds have passed."""
    clock = iter([0.0, *(2.0 * k for k in range(len(PARTS)))])
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    said = io.StringIO()
    with PartProgress(Console(file=said), "study", pause=3.0) as update:
        for part, done in PARTS:
            update(part, done, 100)
    lines = ["[0/100] NORM_x0.1", "[2/100] EXP_x0.1, 3 min 16 s left", "[99/100] figures, 0 s left"]
    assert said.getvalue().split("\n")[:3] == lines and not said.getvalue().split("\n", 3)[3].strip()


def test_one_bar_in_a_terminal():
    """Whatever the number of parts, one line is drawn again and again."""
    said = io.StringIO()
    console = Console(file=said, force_terminal=True, width=120)
    with PartProgress(console, "study") as update:
        for done in range(50):
            update(f"NORM_x{done}", done, 50)
        update("finished", 50, 50)
    assert said.getvalue().count("\n") == 1
    assert "50/50" in said.getvalue() and "finished" in said.getvalue()
