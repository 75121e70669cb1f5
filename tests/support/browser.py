"""Pages of reports in a real browser: opened without a network, and nothing of them cut off."""

import os
import shutil
from importlib.util import find_spec

import pytest

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
MISSING = "there is no chromium: install Debian's package `chromium`, and playwright"
needs_browser = pytest.mark.skipif(CHROMIUM is None or find_spec("playwright") is None, reason=MISSING)
PATIENCE = 300_000  # ms, for machines on which others work
URLS = ("file:", "blob:", "data:")
WIDTHS = (390, 768, 1440)
OUTSIDE = """() => [...document.body.querySelectorAll("*")]
  .filter(e => !e.ownerSVGElement && e.getClientRects().length && getComputedStyle(e).visibility !== "hidden")
  .filter(e => !(e.tagName === "svg" && e.id === "js-plotly-tester"))
  .filter(e => { const r = e.getBoundingClientRect(); return r.left < -1 || r.right > innerWidth + 1; })
  .map(e => `${e.tagName} ${e.className} ${e.id}`)"""
CLIPPED = """() => [...document.querySelectorAll("main svg.main-svg text")]
  .filter(e => e.textContent.trim() && e.getClientRects().length)
  .filter(e => { const box = one => one.getBoundingClientRect();
    const t = box(e), f = box(e.closest(".js-plotly-plot"));
    return t.left < f.left - 2 || t.right > f.right + 2 || t.top < f.top - 2 || t.bottom > f.bottom + 2; })
  .map(e => e.textContent)"""
DRAWN = """() => [...document.querySelectorAll("[data-figure]")].map(e => [e.dataset.figure,
  e.querySelectorAll(".js-plotly-plot svg path, canvas").length > 0])"""


def load(browser, path, width, options=()):
    """A page that is drawn, and the list of what it complains of or asks a network for."""
    said, window = [], {"viewport": {"width": width, "height": 900}, "offline": True}
    page = browser.new_context(**window, **dict(options)).new_page()
    page.set_default_timeout(PATIENCE)
    page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda asked: said.append(asked.url) if asked.url[:5] not in URLS else None)
    page.goto(path.as_uri())
    page.wait_for_selector("body[data-ready]")
    return page, said


def check_width(page):
    """Nothing is beyond the window, and no text beyond its figure."""
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(OUTSIDE) == []
    assert page.evaluate(CLIPPED) == []


def check_widths(page):
    """Opened on a phone, and widened to a tablet and a screen: nothing is cut off, all figures are drawn."""
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(800)
        check_width(page)
    drawn = page.evaluate(DRAWN)
    assert len(drawn) >= 4 and all(is_drawn for _, is_drawn in drawn), drawn


def check_page(browser, path):
    """A page that complains of nothing, and of which nothing is cut off."""
    page, said = load(browser, path, WIDTHS[0])
    check_widths(page)
    page.close()
    assert said == []
