"""The parts of a page and the files beside it, as text."""

import base64
import csv
import json
from html.parser import HTMLParser

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.problems.equations import pendulum_problem
from polyida.run.solve import solve
from polyida.show import figure_files, html, plates, plots
from polyida.show.styles import PALETTE, figure, settings


def curves():
    """Two lines that share their x, one of its own, and a guide without a name."""
    with settings():
        made, axes = figure()
        axes.plot([0.0, 1.0, 2.0], [1.0, np.nan, 3.0], label='a "b" <c>', color=PALETTE[0])
        axes.plot([0.0, 1.0, 2.0], [4.0, 5.0, 6.0], label="d")
        axes.plot([0.5, 1.5], [7.0, 8.0], label="e")
        axes.axhline(2.0)
        axes.plot([0.0, 1.0], [0.0, 1.0])
        axes.set(xlabel="t, s", ylabel=r"$\max|\phi|$")
        return made


def table_of(text):
    head, *rows = csv.reader(text.splitlines())
    return head, rows


def test_the_numbers_of_a_figure_are_those_of_its_named_lines():
    head, rows = table_of(figure_files.csv(curves()))
    assert head == ["t, s", 'max|phi| (a "b" <c>)', "max|phi| (d)", "t, s (e)", "max|phi| (e)"]
    assert rows == [["0", "1", "4", "0.5", "7"], ["1", "", "5", "1.5", "8"], ["2", "3", "6", "", ""]]


def test_the_numbers_of_bodies_are_the_corners_and_stress_of_every_polygon(run):
    head, rows = table_of(figure_files.csv(plots.deformed(run, times=[0.0, 0.04])))
    assert head[:4] == ["x, m", "y, m (t = 0 s)", "number (t = 0 s)", "von Mises stress, kPa (t = 0 s)"]
    x, y, number, stress = np.array(rows, float)[:, 4:8].T
    nodes, offsets = plates.connectivity(run.model)
    assert np.stack([x, y], axis=1) == pytest.approx(run.node_positions(-1)[nodes], abs=1e-8)
    assert number == pytest.approx(np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)))
    assert stress == pytest.approx(run.von_mises(-1)[number.astype(int)] / 1e3)


class Reader(HTMLParser):
    """The cells of tables, tags that were opened and not closed, and where links lead."""

    def __init__(self, text):
        super().__init__()
        self.cells, self.open, self.links, self.ids = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        self.ids += [known["id"]] if "id" in known else []
        self.links += [known[name] for name in ("href", "src", "xlink:href") if name in known]
        self.open += [tag] if tag not in ("meta", "input") else []
        self.cells += [""] if tag in ("td", "th") else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        if {"td", "th"} & set(self.open):
            self.cells[-1] += text


def test_a_table_shows_what_rows_have():
    columns = {
        "name": ("<name>", "{}"),
        "error": ("error", "{:.1e}"),
        "count": ("count", "{}"),
        "good": ("good", "{}"),
        "how": ("how", "code"),
    }
    rows = [
        {"name": "a & b", "error": 0.00123, "count": np.int64(3), "good": True, "how": "IDA(rtol=1e-3)"},
        {"name": None, "error": float("nan"), "count": float("inf"), "good": False},
    ]
    text = html.block_html(html.Table(columns, rows, "what `came`"))
    assert Reader(text).cells == [
        "<name>",
        "error",
        "count",
        "good",
        "how",
        "a & b",
        "1.2e-03",
        "3",
        "yes",
        "IDA(rtol=1e-3)",
        "–",
        "–",
        "–",
        "no",
        "–",
    ]
    assert 'data-value="0.00123"' in text and "<caption>what <code>came</code></caption>" in text and "nan" not in text


def test_a_page_stands_alone_with_its_files_beside_it(tmp_path):
    parts = [html.Heading("One & two"), html.Text("See `a < b`."), html.Notes(["it <failed>"]), html.Notes([])]
    parts += [html.Picture("first", "A curve", curves()), html.Picture("second", "The same curve", curves())]
    path = html.write(tmp_path / "new", "Title <1>", parts, "python mine.py --x '<2>'", machine={"python": "3"}, lead="What it is.")
    assert path == tmp_path / "new" / "report.html"
    made = {f"{name}.{kind}" for name in ("first", "second") for kind in ("png", "pdf", "csv")}
    assert {file.name for file in path.parent.iterdir()} == {"report.html", *made}
    read = Reader(path.read_text())
    assert read.open == [] and len(set(read.ids)) == len(read.ids)
    assert all(link.startswith(("#", "data:")) for link in read.links)
    assert {link[1:] for link in read.links if link[0] == "#"} <= set(read.ids)
    for text in (
        "Title &lt;1&gt;",
        "--x &#39;&lt;2&gt;&#39;",
        "<code>a &lt; b</code>",
        "it &lt;failed&gt;",
        "python 3",
        "What it is.",
        "<text",
    ):
        assert text in path.read_text()
    again = html.write(tmp_path / "again", "Title <1>", parts, "python mine.py --x '<2>'", machine={"python": "3"}, lead="What it is.")
    assert again.read_bytes() == path.read_bytes()


def test_two_pictures_of_one_name_are_refused(tmp_path):
    with pytest.raises(InputError, match="'p'"):
        html.write(tmp_path / "new", "t", [html.Picture("p", "", curves()), html.Picture("p", "", curves())], "")
    assert not (tmp_path / "new").exists()


def test_many_numbers_lie_beside_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(html, "MAX_EMBEDDED_CSV", 50)
    text = html.write(tmp_path, "t", [html.Picture("p", "c", curves())], "").read_text()
    assert 'href="p.csv"' in text and "data:text/csv" not in text and (tmp_path / "p.csv").exists()


def unpacked(data, run):
    """(places (frames, points, 2), m, stress as parts of the colours (frames, cells)) of a movie's data."""
    places = np.frombuffer(base64.b64decode(data["places"]), "<u2").reshape(len(data["t"]), -1, 2).astype(float)
    stress = np.frombuffer(base64.b64decode(data["stress"]), "u1").reshape(len(data["t"]), -1)
    return places, stress / (len(data["colours"]) - 1)


def test_a_movie_has_the_plates_where_the_run_has_them(run):
    data, top = html.Movie(run).data()
    assert json.loads(json.dumps(data)) == data and len(data["t"]) == len(run.t)
    places, stress = unpacked(data, run)
    exact = np.array([run.node_positions(k) for k in range(len(run.t))])
    low, size = np.array(data["low"]), data["size"]
    placed = low + places * size / html.POSITIONS
    assert placed[:, : exact.shape[1]] == pytest.approx(exact, abs=size / html.POSITIONS)
    symbols, *_ = plates.symbols_of(run, np.arange(len(run.t)))
    for name, kind in (("joints", symbols.joints), ("forces", symbols.forces), ("pins", symbols.pins)):
        assert placed[:, np.array(data[name], int).reshape(kind.shape[1:-1])] == pytest.approx(kind, abs=size / html.POSITIONS)
    assert data["start"] == np.abs(exact - exact[0]).sum(axis=(1, 2)).argmax() > 0
    for (place, text), (end, other) in [(marks[0], marks[-1]) for marks in data["ticks"]]:
        assert (end - place) * size / html.POSITIONS == pytest.approx(float(other) - float(text))
    found = np.array([run.von_mises(k) / 1e3 for k in range(len(run.t))])
    assert stress == pytest.approx(np.minimum(found / top, 1), abs=1 / (html.SHADES - 1))
    nodes, offsets = plates.connectivity(run.model)
    assert data["clock"] == plates.clock(run, range(len(run.t)))
    assert data["nodes"] == nodes.tolist() and data["offsets"] == offsets.tolist()


def test_of_a_mesh_too_fine_for_a_page_the_outline_moves(run, monkeypatch):
    whole = unpacked(html.Movie(run).data()[0], run)[0]
    monkeypatch.setattr(html, "MAX_POINTS", 100)
    data, _ = html.Movie(run).data()
    places, stress = unpacked(data, run)
    edges = plates.curves(run.model).edges
    assert data["offsets"] == [0] and stress.size == 0 and len(data["t"]) == html.MIN_FRAMES
    size = data["size"]
    last = places[-1][np.array(data["edges"])] * size / html.POSITIONS
    assert np.diff(last, axis=1) == pytest.approx(np.diff(whole[-1][edges] * size / html.POSITIONS, axis=1), abs=4 * size / html.POSITIONS)


def test_a_movie_of_a_run_without_plates_is_refused():
    problem = pendulum_problem()
    run = solve(problem.model, 0.1, GeneralizedAlpha(h=1e-2), q0=problem.q0, v0=problem.v0)
    with pytest.raises(InputError, match="no plates"):
        html.Movie(run).data()
