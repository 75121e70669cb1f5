"""The pages that Sphinx builds: the reference of all names, links, and their width on a phone."""

import sys
from html.parser import HTMLParser
from io import StringIO
from types import ModuleType
from urllib.parse import unquote, urldefrag, urlsplit

import pytest
from sphinx.application import Sphinx
from sphinx.util.docutils import docutils_namespace, patch_docutils

import pymc_features
from support.browser import URLS, WIDTHS, needs_browser
from support.commands import ROOT

# pages with tables and formulas that are wider than a phone
WIDE = ("genindex", "index", "intervals", "private_hooks", "reference/likelihoods", "reference/sampling")
# furo hides what is beyond the window, and lets its content scroll
BEYOND = """[document.documentElement, document.querySelector(".content")]
  .map(e => e.scrollWidth - e.clientWidth)"""


class Page(HTMLParser):
    """Links of a page, and the places in it that others may link to."""

    def __init__(self, path):
        super().__init__()
        self.links, self.places = [], {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.links += [values[name] for name in ("href", "src") if name in values]
        self.places.add(values.get("id"))


def dead_links(folder) -> list[str]:
    """Local links of pages to files, or to places in pages, that are not there."""
    pages, dead = {path: Page(path) for path in folder.resolve().rglob("*.html")}, []
    for path, page in pages.items():
        for link in page.links:
            address, place = urldefrag(link)
            if not urlsplit(address).scheme:
                target = (path.parent / unquote(urlsplit(address).path)).resolve() if address else path
                if not target.is_file() or (target in pages and unquote(place) not in pages[target].places):
                    dead.append(f"{path.relative_to(folder.resolve())}: {link}")
    return dead


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the pages, warnings, and names in the reference; pictures of the gallery are empty files."""
    docs, folder, warnings = str(ROOT / "docs"), tmp_path_factory.mktemp("pages"), StringIO()
    out = str(folder)
    with patch_docutils(docs), docutils_namespace(), pytest.MonkeyPatch.context() as patch:
        app = Sphinx(docs, docs, out, str(folder / "doctrees"), "html", status=None, warning=warnings)
        gallery = sys.modules["gallery"]

        def blank(place):
            place.mkdir()
            for name in filter(gallery.is_possible, gallery.PICTURES):
                (place / f"{name}.png").touch()

        patch.setattr(gallery, "draw", blank)
        app.build()
    return folder, warnings.getvalue(), set(app.env.domains.python_domain.objects)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # MyST's own
def test_reference_is_built_without_warnings(built):
    """And holds every public name; one that it holds twice is a warning. Names are resolved."""
    _, warnings, shown = built
    assert warnings == ""
    names = [
        name for name in pymc_features.__all__ if not isinstance(getattr(pymc_features, name), ModuleType)
    ]
    assert {f"pymc_features.{name}" for name in [*names, "modal.mac", "structures.spring_forces"]} <= shown
    assert {"pymc_features.signals.trim", "pymc_features.update.read_problem"} <= shown


@pytest.mark.slow
def test_links_of_built_pages_lead_somewhere(built, tmp_path):
    """Files and places in pages; a page with one dead link of each kind has both."""
    assert dead_links(built[0]) == []
    links = '<p id="here"><a href="#here"><a href="#there"><img src="none.png"><a href="page.html#here">'
    (tmp_path / "page.html").write_text(links, encoding="utf-8")
    assert dead_links(tmp_path) == ["page.html: #there", "page.html: none.png"]


@pytest.mark.slow
@needs_browser
def test_built_pages_fit_a_phone_and_need_no_network(built, browser):
    """Wide tables and formulas scroll by themselves; nothing is asked for but files."""
    page, asked = browser.new_page(viewport={"width": WIDTHS[0], "height": 900}, offline=True), []
    page.on("request", lambda request: asked.append(request.url))
    for name in WIDE:
        page.goto((built[0] / f"{name}.html").as_uri())
        assert page.evaluate(BEYOND) == [0, 0], name
    page.close()
    assert len(asked) > len(WIDE)
    assert [url for url in asked if not url.startswith(URLS)] == []
