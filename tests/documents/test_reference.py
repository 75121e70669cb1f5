"""The reference that Sphinx builds."""

from io import StringIO
from types import ModuleType

import pytest
from sphinx.application import Sphinx
from sphinx.util.docutils import docutils_namespace, patch_docutils

import pymc_features
from support.commands import ROOT


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # MyST's own
def test_reference_is_built_without_warnings(tmp_path):
    """And holds every public name; one that it holds twice is a warning. Links are resolved."""
    docs, warnings = str(ROOT / "docs"), StringIO()
    with patch_docutils(docs), docutils_namespace():
        app = Sphinx(docs, docs, str(tmp_path), str(tmp_path), "dummy", status=None, warning=warnings)
        app.build()
    assert warnings.getvalue() == ""
    shown = set(app.env.domains.python_domain.objects)
    names = [
        name for name in pymc_features.__all__ if not isinstance(getattr(pymc_features, name), ModuleType)
    ]
    assert {f"pymc_features.{name}" for name in [*names, "modal.mac", "structures.spring_forces"]} <= shown
    assert {"pymc_features.signals.trim", "pymc_features.update.read_problem"} <= shown
