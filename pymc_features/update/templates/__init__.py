"""Texts that `update` fills in: the page of the report, and examples of a configuration."""

import jinja2

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("pymc_features.update"),
    autoescape=jinja2.select_autoescape(["html"]),
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
