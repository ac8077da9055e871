"""Reports in a headless browser, where one is installed: on a phone and on a desk, light, dark and on paper, by keyboard.

Screenshots go to the folder that POLYIDA_SCREENSHOTS names, if it names one, to be looked at.
"""

import os
from pathlib import Path

import pytest
from PIL import Image

from polyida.cli.commands import main
from polyida.show import figure_files

REPORTS = {
    "double-plate": ["compare", "double-plate", "--cells", "8", "--time", "0.05"],
    "pendulum": ["compare", "pendulum", "--time", "0.5"],
}
TAB, ENTER, SPACE, RIGHT = ("Tab", 9), ("Enter", 13, "\r"), (" ", 32, " "), ("ArrowRight", 39)
CONTRAST = """(() => {
  const luminance = (colour) => colour.match(/\\d+/g).slice(0, 3).map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)).reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const page = luminance(getComputedStyle(document.body).backgroundColor);
  const of = (element) => {
    const text = luminance(getComputedStyle(element)[element.closest("svg") ? "fill" : "color"]);
    return (Math.max(text, page) + 0.05) / (Math.min(text, page) + 0.05);
  };
  return [page, Math.min(...[...document.querySelectorAll("h1, p, a, td, figcaption, footer p, summary, svg text")].map(of))];
})()"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """{name: path of its report.html}."""
    folder = tmp_path_factory.mktemp("reports")
    rendered = figure_files.rendered
    with pytest.MonkeyPatch.context() as patch:  # one process draws, and what is in the page alone
        patch.setattr(figure_files, "rendered", lambda figure, kind: rendered(figure, kind) if kind == "svg" else b"")
        patch.setattr(figure_files, "cores", lambda: 1)
        for name, arguments in REPORTS.items():
            assert main([*arguments, "--out", str(folder / name)]) == 0
    return {name: folder / name / "report.html" for name in REPORTS}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = Path(os.environ.get("POLYIDA_SCREENSHOTS") or tmp_path_factory.mktemp("pictures"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.mark.parametrize("width, scheme", [(360, "dark"), (1280, "light")])
@pytest.mark.parametrize("name", REPORTS)
def test_a_report_fits_its_window_without_an_error(browser, reports, pictures, name, width, scheme):
    browser.open(reports[name], width, scheme)
    assert browser.value("window.innerWidth") == width
    assert browser.value("document.documentElement.scrollWidth") <= width
    background, contrast = browser.value(CONTRAST)
    assert background < 0.02 if scheme == "dark" else background == 1
    assert contrast >= 4.5
    assert browser.value("performance.getEntriesByType('resource').length") == 0
    shot = pictures / f"{name}-{width}-{scheme}.png"
    browser.screenshot(shot)
    with Image.open(shot) as image:
        assert abs(image.width - width) < 20 and len(image.convert("RGB").getcolors(1 << 24)) > 50
    assert browser.errors == []


def column(browser, number):
    return browser.value(f"[...document.querySelectorAll('table')[0].tBodies[0].rows].map((row) => row.cells[{number}].textContent)")


def test_tables_sort_by_numbers_and_what_is_missing_is_last(browser, reports):
    browser.open(reports["double-plate"], 1280)
    headings = browser.value("[...document.querySelectorAll('table')[0].tHead.rows[0].cells].map((cell) => cell.textContent)")
    steps, error = headings.index("steps"), headings.index("tip error, largest, m")
    as_written = column(browser, 0)
    browser.value(f"document.querySelectorAll('table')[0].tHead.rows[0].cells[{steps}].querySelector('button').click()")
    assert [int(text) for text in column(browser, steps)] == sorted(map(int, column(browser, steps))) and column(browser, 0) != as_written
    press = f"document.querySelectorAll('table')[0].tHead.rows[0].cells[{error}].querySelector('button')"
    browser.value(f"{press}.focus()")
    for order, sign in (("ascending", 1), ("descending", -1)):
        browser.press(*ENTER)
        *values, last = column(browser, error)
        assert last == "–" and [float(text) for text in values] == sorted(map(float, values), key=lambda value: sign * value)
        sorts = browser.value(
            "[...document.querySelectorAll('table')[0].tHead.rows[0].cells].map((cell) => cell.getAttribute('aria-sort'))"
        )
        assert [sort for sort in sorts if sort] == [order] and sorts[error] == order


def test_the_keyboard_reaches_everything_that_can_be_done(browser, reports):
    browser.open(reports["double-plate"], 360)
    browser.value("document.querySelectorAll('details').forEach((numbers) => (numbers.open = false))")
    reached = []
    for _ in range(120):
        browser.press(*TAB)
        reached.append(
            browser.value("(({tagName, className, textContent}) => `${tagName}.${className} ${textContent}`)(document.activeElement)")
        )
        if reached[-1].startswith("BODY"):
            break
    assert reached[0] == "A.skip Skip to the content"
    count = browser.value("""[...document.querySelectorAll('button, input, summary, a[href], .wide')]
      .filter((element) => element.checkVisibility() && !element.closest('details:not([open]) > :not(summary)')).length""")
    assert len(reached) - 1 == count
    for kind in ("BUTTON. Play", "INPUT.", "BUTTON. steps", "A. numbers", "DIV.wide", "SUMMARY."):
        assert any(found.startswith(kind) for found in reached), kind


CANVAS = "document.querySelector('canvas').toDataURL()"
FRAME = "+document.querySelector('.movie input').value"
PLAY = "document.querySelector('.movie button').textContent"
MOVES = f"""new Promise((done) => {{
  const end = Date.now() + 10000;
  const look = () => ({FRAME} > 1 || Date.now() > end ? done({FRAME} > 1) : setTimeout(look, 20));
  look();
}})"""


def test_the_motion_plays_when_asked_and_its_slider_leads_to_every_frame(browser, reports):
    browser.open(reports["double-plate"], 1280, motion="reduce")
    browser.value("document.querySelector('canvas').scrollIntoView()")
    browser.value("new Promise((done) => setTimeout(done, 300))")
    assert browser.value(PLAY) == "Play" and browser.value(FRAME) > 0  # a frame far from the first one
    browser.value("document.querySelector('.movie input').focus()")
    browser.press("Home", 36)
    assert browser.value(FRAME) == 0
    first = browser.value(CANVAS)
    browser.press(*RIGHT)
    assert browser.value(FRAME) == 1 and browser.value(CANVAS) != first
    assert browser.value("document.querySelector('.movie output').value") != "t = 0.000 s"
    browser.value("document.querySelector('.movie button').focus()")
    browser.press(*SPACE)
    assert browser.value(PLAY) == "Pause" and browser.value(MOVES)
    browser.press(*SPACE)
    assert browser.value(PLAY) == "Play" and browser.errors == []


def test_without_scripts_everything_is_there_to_read(browser, reports):
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(reports["double-plate"], 1280)
        shown = browser.value("document.body.innerText")
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)
    for text in ("generalized-alpha", "tip error, largest, m", "GeneralizedAlpha(h=0.001", "needs a script", "polyida compare", "numpy"):
        assert text in shown
    assert "Play" not in shown
