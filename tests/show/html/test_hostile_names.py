"""Names and texts that a user can give, in pages in a headless browser: none of them runs, and each is shown as it was given."""

from xml.etree import ElementTree

import numpy as np
import pytest

import polyida as pi
from polyida.reprs import cut
from polyida.show import figure_files, html, plots
from polyida.show.styles import save
from polyida.study.result import StudyResult
from polyida.study.tasks import Study

HANDLER = "document.title='run'"
HOSTILE = {
    "element": f"<img src=x onerror={HANDLER}>",
    "script": f"</script><script>{HANDLER}</script>",
    "svg": f"</title></style></svg><svg/onload={HANDLER}>",
    "attribute": f"\" onfocus={HANDLER} autofocus tabindex=1 x='",
    "link": f"javascript:{HANDLER}//",
    "template": "{{ 7 * 7 }}{% raw %}`</code><iframe srcdoc='<script>parent." + HANDLER + "</script>'>`",
    "comment": f"--><!--<script>{HANDLER}</script>]]>&lt;b&gt;",
}


def fill(text):
    """A scene in which every part has a hostile name, and a run of it with a hostile event."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=4, seed=1), pi.Material(5e7, 0.3, 1100.0), 0.01, name=f"{text} plate")
    body = scene.add(pi.Rigid(plate))
    bar = scene.add(
        pi.RigidBody(mass=1.0, inertia=0.1, points={text: (0.5, 0.0), "end": (0.0, 0.0)}, origin=(1.0, 0.0), name=f"{text} bar")
    )
    scene.add(pi.Revolute(pi.ground, body.section("left"), name=f"{text} joint"))
    scene.add(pi.Revolute(body.section("right"), bar.at("end"), name=f"{text} hinge"))
    scene.add(pi.PointMass(bar.at(text), 0.1, name=f"{text} mass"))
    scene.add(pi.Force(bar.at(text), (0.0, 1.0), name=f"{text} force"))
    event = pi.Event(when=lambda state: state.t - 2e-3, name=f"{text} event", then=pi.Remove(f"{text} force"))
    run = pi.solve(scene.build(), 4e-3, pi.GeneralizedAlpha(h=1e-3), events=[event])
    scene.add(pi.Contact(bar.at(text), pi.ground.at((0.0, -5.0)), name=f"{text} contact"))
    return scene, run


@pytest.fixture(scope="module", params=HOSTILE)
def hostile(request):
    """(text, scene, run)."""
    text = HOSTILE[request.param]
    return text, *fill(text)


@pytest.fixture(autouse=True)
def only_svg(monkeypatch):
    """Draw what is in the page alone."""
    rendered = figure_files.rendered
    monkeypatch.setattr(figure_files, "rendered", lambda figure, kind: rendered(figure, kind) if kind == "svg" else b"")


def require_harmless(browser, path, texts):
    """No handler of a page runs, nor is there one, and the page shows the texts."""
    for policy in (True, False):  # the page's policy is a second line: the texts are harmless without it, too
        browser.ask("Page.setBypassCSP", enabled=not policy)
        browser.open(path, 1280)
        browser.value("document.querySelectorAll('*').forEach((one) => { one.focus?.(); })")
        browser.value("document.querySelectorAll('a[href]').forEach((one) => { if (one.href.startsWith('javascript')) one.click(); })")
        browser.value("new Promise((done) => setTimeout(done, 50))")
        assert browser.value("document.title") != "run", policy
        made = "[...document.querySelectorAll('*')].filter((one) => [...one.attributes].some(({name}) => name.startsWith('on'))).length"
        assert browser.value(made) == 0
        assert browser.value("document.querySelectorAll('iframe, img, object, embed, base, link').length") == 0
    shown = browser.value("document.body.textContent")
    for text in texts:
        assert text in shown, text
    browser.ask("Page.setBypassCSP", enabled=False)


def test_no_text_of_a_report_runs(browser, hostile, tmp_path):
    text, _, run = hostile
    plain = text.replace("`", "'")  # backticks mark code in notes
    runs = {f"{text} label": run}
    pictures = {
        "histories": plots.reactions(runs, [f"{text} joint", f"{text} hinge"]),
        "path": plots.tip(runs, f"{text} mass"),
        "energy": plots.energy(runs),
        f"{text[:40]}".replace("/", ":"): plots.drift(runs),
    }
    events = [{"name": event.name, f"{text} column": event.t} for event in run.events]
    parts = [html.Heading(f"{text} heading"), html.Text(plain), html.Notes([f"{plain} note"])]
    parts += [html.Table({"name": (f"{text} column", "{}"), "code": ("code", "code")}, [*events, {"name": text, "code": text}], plain)]
    parts += [html.Picture(name, plain, figure) for name, figure in pictures.items()] + [html.Movie(run, plain)]
    path = html.write(tmp_path / "report", f"{text} title", parts, f"{text} command", machine={"python": text}, lead=plain)
    texts = [f"{text} {what}" for what in ("heading", "column", "event", "command", "title")] + [plain, f"{plain} note", text]
    require_harmless(browser, path, texts)


def test_no_text_of_a_study_or_a_sweep_runs(browser, hostile, tmp_path):
    text = hostile[0]
    plain = text.replace("`", "'")

    def task(**case):
        if case[text] == 2:
            raise ValueError(text)
        return {f"{text} result": 1.0, "words": text}

    cases = [{text: k} for k in range(3)]
    sweep = pi.study.sweep(lambda **case: task(**case), cases)
    require_harmless(browser, sweep.report(tmp_path / "sweep", command=text) / "report.html", [text, f"{text} result"])
    study = Study("named", plain, lambda quick: cases, task, lambda rows: {text: 1.0}, notes=lambda rows: [plain])
    (tmp_path / "study").mkdir()
    StudyResult(study, sweep.rows).write(tmp_path / "study", text)
    require_harmless(browser, tmp_path / "study" / "report.html", [text, plain])


def test_no_text_of_a_notebook_or_a_picture_runs(browser, hostile, tmp_path):
    text, scene, run = hostile
    sweep = pi.study.sweep(lambda **case: {f"{text} result": 1.0, "words": text}, [{text: 1}])
    shown = "".join(thing._repr_html_() for thing in (scene, run.model, run, sweep))
    page = tmp_path / "notebook.html"
    page.write_text(f'<!doctype html><meta charset="utf-8"><title>notebook</title><body>{shown}</body>', encoding="utf-8")
    require_harmless(browser, page, [f"{text} plate", f"{text} joint", f"{text} contact"])
    picture = save(plots.reactions({f"{text} label": run}, [f"{text} joint"]), tmp_path / "picture.svg")
    root = ElementTree.parse(picture).getroot()
    assert not any(name.lower().startswith("on") for part in root.iter() for name in part.attrib)
    assert not any(part.tag.rpartition("}")[2] in ("script", "foreignObject", "a") for part in root.iter())
    browser.open(picture, 1280)
    assert browser.value("document.title") != "run"
    assert np.any([cut(f"{text} label", plots.LONGEST_NAME) in (part.text or "") for part in root.iter()])
