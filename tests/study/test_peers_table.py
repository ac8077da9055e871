"""The guide's table against peers: it is whole, every cell says where it is from, and the checks of what is installed say the same."""

import re
from pathlib import Path

from peers_table.cells import checks_of
from peers_table.cells import run as looked_at
from peers_table.rows import PEERS, ROWS
from polyida.study.executors import Worker

PAGE = Path(__file__).parents[2] / "studies" / "guide" / "peers.md"
COLUMNS = [*PEERS, "SciML"]
FACTS = {"licence", "binaries", "language of the hot path", "who makes it"}
NOTE = re.compile(r"\[\^([\w-]+)\]")


def table_of(text):
    """[(row, peer, cell)] of all tables of the page."""
    found, columns = [], None
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")] if line.startswith("|") else None
        if cells is None:
            columns = None
        elif columns is None:
            columns = cells if cells[0] == "" else [""] + cells
            columns = [name for name in columns if name]
            assert columns == COLUMNS
        elif not set(line) <= set("|-: "):
            assert len(cells) == 1 + len(columns), line
            found += [(cells[0], peer, cell) for peer, cell in zip(columns, cells[1:])]
    return found


TEXT = PAGE.read_text(encoding="utf-8")
CELLS = table_of(TEXT)
NOTES = dict(re.findall(r"^\[\^([\w-]+)\]: (.+)$", TEXT, re.MULTILINE))
MARKS = {(row, peer): NOTE.sub("", cell).split() for row, peer, cell in CELLS if row not in FACTS}
INSTALLED = "polyida", "scikit-sundae"


def test_every_row_and_every_peer_is_there_once():
    rows = [row for row, peer, cell in CELLS if peer == "polyida"]
    assert [row for row in rows if row not in FACTS] == list(ROWS) and set(rows) - set(ROWS) == FACTS
    assert len(CELLS) == len(rows) * len(COLUMNS)


def test_every_cell_has_a_mark_and_says_where_it_is_from():
    for row, peer, cell in CELLS:
        notes, seen = NOTE.findall(cell), "✓" in cell
        assert set(notes) <= set(NOTES) and (seen or notes), (row, peer)
        if row in FACTS:
            assert NOTE.sub("", cell).strip(), (row, peer)
            continue
        mark = MARKS[row, peer][0]
        assert mark in ("yes", "part", "no", "own") and MARKS[row, peer][1:] in ([], ["✓"]), (row, peer)
        assert notes or mark in ("yes", "no"), (row, peer)
        assert seen or peer == "polyida" or any("https://" in NOTES[note] for note in notes), (row, peer)
    assert {note for row, peer, cell in CELLS for note in NOTE.findall(cell)} == set(NOTES)


def test_a_cell_is_marked_as_seen_where_there_is_a_check():
    checked = {(row, peer) for peer in PEERS for row in checks_of(peer)}
    assert {place for place, mark in MARKS.items() if "✓" in mark} == checked


def test_the_checks_of_what_is_installed_say_the_same():
    with Worker() as worker:
        for peer, row in [(peer, row) for peer in PEERS for row in checks_of(peer)]:
            said = worker.call(looked_at, {"peer": peer, "row": row}, 120.0)
            if said.get("found") == "not installed":
                assert peer not in INSTALLED
                continue
            assert not said["error"] and said["says"] and said["version"], (peer, row, said)
            assert (said["found"] == "not seen") == (MARKS[row, peer][0] == "no"), (peer, row, said)
