"""Tables at any width: no line is longer than it, a number stays whole, and what has no room is told."""

import re

import pytest

from polyida.cli import output
from polyida.cli.output import Grid

NUMBER = re.compile(r"-?\d\.\d+e[+-]\d+")
RUNS = Grid(
    ["", "tip error, largest, m", "tip error, at the end, m", "CPU s", "steps", "newton_iterations", "energy change, J"],
    [
        [name, f"{1.5e-5 * k:.2e}", f"{1.25e-5 * k:.2e}", f"{0.5 * k:.2f}", f"{1000 * k}", f"{2000 * k}", f"{-1e-3 * k:.2e}"]
        for k, name in enumerate(("generalized-alpha", "IDA", "Radau IIA", "Rattle (mine)", "refined run"), 1)
    ],
)
SWEEP = Grid(
    ["case", "empty", "same", "detail", "error_q", "outcome"],
    [[f"{k}", "", "1e-05", f"{k}{k}", f"{k * 1e-4:.3e}", "it went as far as it could, and then no further at all"] for k in range(3)],
    minor=["detail"],
)


def printed(capsys, monkeypatch, width, *grids):
    monkeypatch.setenv("COLUMNS", str(width))
    output.print_grid("a title", *grids, complete_in="report.html")
    return capsys.readouterr().out


@pytest.mark.parametrize("width", [200, 100, 80, 60, 40, 30])
def test_no_line_is_wider_than_the_terminal_and_every_number_whole(capsys, monkeypatch, width):
    said = printed(capsys, monkeypatch, width, RUNS.transposed(), RUNS)
    assert max(map(len, said.splitlines())) <= width
    numbers = {cell for row in RUNS.rows for cell in row if NUMBER.fullmatch(cell)}
    assert set(NUMBER.findall(said)) <= numbers and "1.50e-05" in said
    assert ("report.html has all" in " ".join(said.split())) == ("No room" in said)


def test_with_room_runs_are_columns_and_without_they_are_rows(capsys, monkeypatch):
    wide, narrow = (printed(capsys, monkeypatch, width, RUNS.transposed(), RUNS) for width in (120, 60))
    assert re.search(r"steps +1000 +2000 +3000 +4000 +5000", wide) and "No room" not in wide
    assert re.search(r"Rattle \(mine\) +6.00e-05 +5.00e-05", narrow) and "No room for energy change, J: report.html has all." in narrow


def test_empty_columns_go_first_then_those_of_one_value_then_details(capsys, monkeypatch):
    assert [SWEEP.headings[i] for i in SWEEP.removal_order()] == ["empty", "outcome", "same", "detail", "error_q"]
    assert "No room" not in printed(capsys, monkeypatch, 60, SWEEP)
    for width, gone in ((30, "same (1e-05), outcome (it went as fa…)"), (17, "same (1e-05), detail, outcome (it went as fa…)")):
        assert f"No room for {gone}: report.html has all." in " ".join(printed(capsys, monkeypatch, width, SWEEP).split())


def test_texts_take_the_lines_that_they_need(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    output.print_texts(["name", "what it is"], [["double-plate-motors", "Two plates with a motor in each joint."]])
    said = capsys.readouterr().out
    assert "double-plate-motors" in said and max(map(len, said.splitlines())) <= 40
    assert " ".join(said.replace("double-plate-motors", "").split()).endswith("Two plates with a motor in each joint.")
