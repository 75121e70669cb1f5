"""The page of a report in a real browser: nothing is cut off at three widths, and all that moves does."""

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from pymc_features import ModalDamping, SpringMassChain, simulate
from pymc_features.update import read_problem, run_update, write_outputs
from pymc_features.update.report.page import page_of
from support.browser import OUTSIDE, check_width, check_widths, load, needs_browser
from support.report_pages import payload
from support.report_results import large_result
from update import test_update_modal as modal

pytestmark = [pytest.mark.slow, needs_browser]
LAPLACE = '\n[sampler]\nmethod = "laplace"\ndraws = 300\ncores = 1\n'


@pytest.fixture(scope="module")
def pages(tmp_path_factory, blank_module) -> dict[str, Path]:
    """A large page, and that of modes and accelerations by Laplace's approximation."""
    large = tmp_path_factory.mktemp("pages") / "large.html"
    large.write_text(page_of(large_result()), encoding="utf-8")
    files = modal.folder.__wrapped__(tmp_path_factory)
    both = modal.MODAL + modal.with_damping(modal.STRUCTURE) + modal.DATA.replace('"EXP"', '"NORM", "EXP"')
    problem = read_problem(modal.write(files, "both", both + LAPLACE))
    result = run_update(problem, progressbar=False)
    return {"large": large, "modal": write_outputs(problem, result, files / "out")[-1]}


@pytest.fixture(scope="module")
def opened() -> dict:
    """Pages that are open, with what they complained of."""
    return {}


@pytest.fixture
def view(browser, pages, opened):
    """Open a page without a network, or one that is open anew; a complaint in its console fails the test."""
    used = []

    def open_page(name, width=1440, **options):
        key = (name, width, *sorted(options))
        if key not in opened:
            opened[key] = load(browser, pages[name], width, options)
        used.append(opened[key])
        page, _ = opened[key]
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate("change('kind', payload.kinds[0]); change('sensor', 0); change('window', 'all')")
        page.evaluate("scrollTo(0, 0)")
        return page

    yield open_page
    assert [said for _, said in used if said] == []


@pytest.mark.parametrize("name", ["large", "modal"])
def test_nothing_is_cut_off(view, name):
    check_widths(view(name, 390))


def test_what_is_too_wide_is_seen(view):
    """The check above can fail; it holds where a page is opened wide."""
    check_width(view("modal", 768))
    page = view("modal", 390)
    page.evaluate("document.querySelector('h2').style.width = '500px'")
    assert page.evaluate(OUTSIDE) != []
    page.evaluate("document.querySelector('h2').style.width = ''")


def area(page, figure, x, y):
    """Corner and size of a panel of a plot, with the names of its axes."""
    return page.evaluate(
        f"""() => {{ const plot = document.querySelector('[data-figure={figure}] .plot');
        plot.scrollIntoView({{block: "center"}});
        const {{{x}: x, {y}: y}} = plot._fullLayout, box = plot.getBoundingClientRect();
        return [box.left + x._offset, box.top + y._offset, x._length, y._length]; }}"""
    )


def drag(page, box, start, end):
    """Drag over a part of a panel."""
    left, top, width, height = box
    page.mouse.move(left + start[0] * width, top + start[1] * height)
    page.mouse.down()
    for share in np.linspace(0.0, 1.0, 6)[1:]:
        x, y = np.array(start) + share * (np.array(end) - start)
        page.mouse.move(left + x * width, top + y * height)
    page.mouse.up()
    page.wait_for_timeout(600)


def test_the_response_can_be_zoomed(view):
    page = view("modal")
    read = "document.querySelector('[data-figure=response] .plot')._fullLayout.xaxis.range"
    before = page.evaluate(read)
    drag(page, area(page, "response", "xaxis", "yaxis"), (0.25, 0.5), (0.5, 0.52))
    after = page.evaluate(read)
    length = before[1] - before[0]
    assert after[0] == pytest.approx(before[0] + 0.25 * length, abs=0.02 * length)
    assert after[1] == pytest.approx(before[0] + 0.5 * length, abs=0.02 * length)
    page.click("[data-window=strong]")
    assert np.ptp(page.evaluate(read)) < 0.7 * length
    page.click("[data-window=all]")
    assert page.evaluate(read) == before


def test_each_sensor_can_be_chosen(view, pages):
    page = view("modal")
    sensors = payload(pages["modal"].read_text())["measured"]["sensors"]
    assert page.eval_on_selector_all("#sensor option", "all => all.map(o => o.textContent)") == sensors
    shown = "document.querySelector('[data-figure=response] .plot').data.find(t => t.name === 'measured').y"
    first = page.evaluate(shown)
    page.select_option("#sensor", label=sensors[1])
    second = page.evaluate(shown)
    assert first != second and np.std(second) > 1.2 * np.std(first)  # the top moves more
    assert sensors[1] in page.inner_text("[data-figure=response] figcaption")


def test_another_likelihood_can_be_chosen(view):
    page = view("modal", 390)
    widths = []
    for kind in ("NORM", "EXP"):
        page.select_option("#kind", kind)
        widths.append(
            page.evaluate("current().parameters.k1.quantiles[2] - current().parameters.k1.quantiles[0]")
        )
        seen = page.eval_on_selector_all(
            "#posterior tbody tr", "rows => rows.filter(r => r.offsetParent).map(r => r.cells[0].textContent)"
        )
        assert set(seen) == {kind}  # on a phone the table is that of the one chosen
    assert widths[1] > 2.0 * widths[0]  # EXP claims fewer observations


def test_predictions_can_be_chosen(view):
    """The curve passes through what is counted of the peaks, and the limits lie on it."""
    page = view("large")
    place = "document.querySelector('[data-figure=prediction] .plot')"
    peaks = large_result()["predict/stronger/inter_storey_drift_peak"].values.max(axis=1)
    curve, limits = page.evaluate(f"[2, 3].map(k => ({{x: {place}.data[k].x, y: {place}.data[k].y}}))")
    np.testing.assert_allclose(curve["x"], 1e3 * np.sort(peaks), atol=1e-4 * 1e3 * np.ptp(peaks))
    np.testing.assert_allclose(curve["y"], 1.0 - (np.arange(500) + 0.5) / 500)
    assert limits["x"] == [20.0, 30.0, 50.0]
    np.testing.assert_allclose(np.interp(limits["x"], curve["x"], curve["y"]), limits["y"], atol=0.002)
    assert "drift, storey 1 under stronger, where it is largest" in page.inner_text(
        "[data-figure=prediction] figcaption"
    )
    page.select_option("#predicted", label="stronger: base shear")
    assert page.evaluate(f"{place}.layout.yaxis.title.text") == "base shear [kN]"
    assert page.evaluate(f"{place}.data[3].x.length") == 0
    page.select_option("#predicted", label="stronger: inter storey drift")


def test_draws_that_are_brushed_light_up_everywhere(view):
    page = view("modal")
    panel = area(page, "pairs", "xaxis", "yaxis2")
    drag(page, panel, (0.02, 0.02), (0.5, 0.98))  # the left half of k1 against k2
    chosen = page.evaluate("chosen.draws")
    values = page.evaluate("drawsOf(current().draws.names[0])")
    middle = page.evaluate("document.querySelector('[data-figure=pairs] .plot')._fullLayout.xaxis.range")
    expected = [k for k, value in enumerate(values) if value < np.mean(middle)]
    assert 20 < len(chosen) < len(values) and set(chosen) ^ set(expected) <= near(values, np.mean(middle))
    lit = page.evaluate(
        "document.querySelector('[data-figure=pairs] .plot').data.filter(t => t.mode === 'markers')"
        ".map(t => t.selectedpoints)"
    )
    assert len(lit) >= 3 and all(sorted(points) == sorted(chosen) for points in lit)
    plots = "[...document.querySelectorAll('[data-figure={0}] .js-plotly-plot')]"
    names = f"{plots}.map(plot => plot.data.map(trace => trace.name))"
    assert "selected draws" in page.evaluate(names.format("response"))[0]
    assert all("selected" in one for one in page.evaluate(names.format("densities")))
    assert page.inner_text("#clear") == f"{len(chosen)} draws selected: clear"
    page.click("#clear")
    assert page.evaluate("chosen.draws") is None and page.is_hidden("#clear")
    assert "selected draws" not in page.evaluate(names.format("response"))[0]


def near(values, limit):
    """Draws within a pixel or two of the edge."""
    return {k for k, value in enumerate(values) if abs(value - limit) < 0.02 * np.ptp(values)}


def test_selected_responses_are_those_of_their_draws(view, pages):
    """The response of one draw by its principal components, against the simulation of its structure."""
    page, folder = view("modal"), pages["modal"].parent.parent
    problem = read_problem(folder / "both.toml")
    with xr.open_datatree(folder / "out" / "update.nc", engine="h5netcdf") as tree:
        posterior, kept = (
            tree["NORM/posterior"].to_dataset().load(),
            tree["NORM/histories"].to_dataset().load(),
        )
    page.evaluate("change('draws', [17])")
    drawn = page.evaluate("selectedResponses(1)")[0]
    one = posterior.sel(chain=kept["chain"][17].item(), draw=kept["draw"][17].item())
    chain = SpringMassChain(
        [modal.MASS] * 3, modal.DRAWN * [float(one[k]) for k in modal.TRUE], ModalDamping(0.02)
    )
    expected = simulate(chain, problem.measured.record, sensors=[2]).values[0]
    median = page.evaluate("responseOf(1).median")
    off, apart = np.subtract(drawn, expected), np.subtract(median, expected)
    assert np.sqrt(np.mean(off**2)) < 0.2 * np.sqrt(np.mean(apart**2))
    assert np.std(apart) > 0.0


def test_mode_shapes_move_turn_and_can_be_chosen(view):
    page = view("modal", reduced_motion="reduce")
    picture = "document.querySelector('[data-figure=shapes] canvas').toDataURL()"
    page.locator("[data-figure=shapes]").scroll_into_view_if_needed()
    still = page.evaluate(picture)
    page.wait_for_timeout(300)
    assert page.evaluate(picture) == still  # who wants no motion gets none
    page.click("#play")
    page.wait_for_timeout(400)
    assert page.evaluate(picture) != still
    page.click("#play")
    before = page.evaluate(picture)
    page.select_option("#mode", label="f2")
    chosen = page.evaluate(picture)
    assert chosen != before and "Mode 2" in page.inner_text("[data-figure=shapes] figcaption")
    assert re.search(r"identified mode 2 at 8\.\d+ Hz, with a MAC of 0\.99|1\.000", page.content())
    box = page.locator("[data-figure=shapes] canvas").bounding_box()
    drag(page, list(box.values()), (0.4, 0.5), (0.7, 0.6))
    assert page.evaluate(picture) != chosen
    turned = page.evaluate(picture)
    page.check("#turn")
    page.wait_for_timeout(400)
    assert page.evaluate(picture) != turned


def test_files_can_be_downloaded(view, pages):
    page = view("modal")
    for button in ("table.csv", "table.tex"):
        with page.expect_download() as waiting:
            page.click(f"[data-file='{button}']")
        assert Path(waiting.value.path()).read_bytes() == pages["modal"].with_name(button).read_bytes()
    with page.expect_download() as waiting:
        page.click("[data-file='table-as-shown.csv']")
    first = Path(waiting.value.path()).read_text().splitlines()[0]
    assert first == "likelihood,parameter,unit,5 %,50 %,95 %,mean,sd,learned,R-hat,ESS"
    for figure, text, start in (
        ("response", "SVG", b"<svg"),
        ("shapes", "SVG", b"<svg"),
        ("mac", "PNG", b"\x89PNG"),
    ):
        with page.expect_download() as waiting:
            page.click(f"[data-figure={figure}] button:text-is('{text}')")
        assert Path(waiting.value.path()).read_bytes().startswith(start)


def test_a_finger_scrolls_until_it_is_told_to_zoom(view):
    page = view("modal", 390, has_touch=True, is_mobile=True)
    mode = "document.querySelector('[data-figure=response] .plot')._fullLayout.dragmode"
    assert page.evaluate(mode) is False
    page.tap("[data-figure=response] button:text-is('Touch to zoom')")
    assert page.evaluate(mode) == "zoom"
    page.tap("[data-figure=response] button:text-is('Touch to scroll')")
    assert page.evaluate(mode) is False


def test_it_prints_within_the_sheet(view):
    page = view("modal", color_scheme="light")  # a window of its own
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 688, "height": 1000})  # A4 less its margins
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.wait_for_timeout(500)
    assert page.evaluate(OUTSIDE) == [] and page.is_hidden("nav") and page.is_hidden("[data-file]")
    assert len(page.pdf(format="A4")) > 50_000


def test_a_large_page_answers(view):
    """All of it is drawn; brushing 600 draws redraws within a second or two."""
    page = view("large")
    start = time.perf_counter()
    page.evaluate("change('draws', [1, 2, 3, 4])")
    assert time.perf_counter() - start < 10.0
    assert json.loads(page.evaluate("JSON.stringify(payload.measured.samples)"))[0] == 10_000
    assert "are drawn, in each short stretch" in page.inner_text("[data-figure=response] figcaption")
