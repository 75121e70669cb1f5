"""Sphinx: `python -m uv run sphinx-build docs docs/_build`. Nothing is downloaded."""

import os
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
sys.path.insert(0, str(Path(__file__).parent))  # the directives

project = "pymc_features"
author = "The pymc_features authors"
extensions = [
    "myst_parser",
    "numpydoc",
    "formulas",
    "gallery",
    "notebook_list",
    "public_names",
    "sphinx.ext.autodoc",
]
html_theme = "furo"
html_title = "pymc_features"
html_static_path = ["_static"]
html_css_files = ["narrow.css"]
exclude_patterns = ["_build"]
templates_path = []

myst_heading_anchors = 3

autodoc_typehints = "none"  # types, shapes and units are in the docstrings
numpydoc_show_class_members = False
default_role = "py:obj"  # a name in single backticks is a link where it is one of ours
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!pymc_features\.).*")]  # others' names are not looked up
