"""Formulas as outlines, drawn by Matplotlib when the pages are built: these need no network."""

from docutils import nodes
from matplotlib.textpath import TextPath

SIZE = 15.0  # px
LETTERS = {1: "M", 2: "L", 3: "Q", 4: "C"}  # Matplotlib's codes of a path, in SVG


def outline(formula: str) -> str:
    """SVG of one line of TeX, in the colour of the text around it."""
    path = TextPath((0.0, 0.0), f"${formula}$", size=SIZE)
    drawn = "".join(
        LETTERS[code] + " ".join(f"{x:.2f}" for x in points) if code in LETTERS else "Z"
        for points, code in path.iter_segments(simplify=False)
    )
    box = path.get_extents()
    width, height = box.width + 2.0, box.height + 2.0
    view = f"{box.x0 - 1.0:.2f} {-box.y1 - 1.0:.2f} {width:.2f} {height:.2f}"
    return (
        f'<svg role="img" viewBox="{view}" width="{width:.0f}" height="{height:.0f}">'
        f'<path transform="scale(1 -1)" fill="currentColor" d="{drawn}"/></svg>'
    )


def draw(translator, node):
    """All lines of a formula, in the box of furo that scrolls; TeX is shown under the pointer."""
    for line in " ".join(node.astext().split()).split(r"\\"):
        title = translator.attval(line.strip())
        translator.body.append(f'<div title="{title}">{outline(line.strip())}</div>\n')
    raise nodes.SkipNode


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("outline", inline_renderers=(draw, None), block_renderers=(draw, None))
    return {"parallel_read_safe": True}
