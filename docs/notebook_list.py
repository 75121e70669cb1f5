"""The directive `notebooks`: the notebooks by their titles, to download. Nothing is executed."""

import json
import re
from pathlib import Path

from sphinx.util.docutils import SphinxDirective

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"


def title(path: Path) -> str:
    """First heading of a notebook."""
    text = "".join(json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"])
    return re.match(r"# (.+)", text)[1]


def notebooks() -> list[Path]:
    """All notebooks, in the order of their numbers."""
    return sorted(FOLDER.glob("*.ipynb"), key=lambda path: int(path.name.partition("_")[0]))


class Notebooks(SphinxDirective):
    """A list of all notebooks, in the order of their numbers."""

    def run(self):
        paths = notebooks()
        rows = [f"- {title(path)} {{download}}`{path.name} <../notebooks/{path.name}>`" for path in paths]
        self.env.note_reread()  # new notebooks appear
        return self.parse_text_to_nodes("\n".join(rows))


def setup(app):
    """Called by Sphinx."""
    app.add_directive("notebooks", Notebooks)
    return {"parallel_read_safe": True}
