"""What `update` fills in: the page of the report, examples of a configuration, and numbers for people."""

import jinja2

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("pymc_features.update"),
    autoescape=jinja2.select_autoescape(["html"]),
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
