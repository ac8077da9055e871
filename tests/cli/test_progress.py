"""Time left: what is told, from what was done."""

import pytest

from polyida.cli import output


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand."""
    now = [100.0]
    monkeypatch.setattr(output.time, "monotonic", lambda: now[0])
    return now


def test_a_study_s_time_left_counts_what_was_run_and_not_what_was_read(clock):
    told = []
    tell = output.TaskProgress("study", lambda *given: told.append(given))
    tell(0, 10, {"x": 0})
    for done in range(1, 5):  # four are there already
        clock[0] += 1e-3
        tell(done, 10, {"x": done})
    for done, seconds in ((5, 10.0), (6, 20.0)):
        clock[0] += seconds
        tell(done, 10, {"x": done})
    assert [left for *_, left in told] == [None] * 5 + [50.0, 60.0]
    assert told[-1][:3] == ("study", 0.6, "6/10 x 6")


def test_a_stage_s_time_left_is_that_at_its_pace(clock, capsys):
    display = output.ProgressDisplay()
    display("alpha", 0.0)
    clock[0] += 30.0
    display("alpha", 0.25)
    clock[0] += 30.0
    display("IDA", 0.5)
    assert capsys.readouterr().err.splitlines() == ["alpha: 25%, 0:01:30 left", "IDA: 50%"]
    assert output.time_left_text(3723.4) == "1:02:03 left" and output.time_left_text(None) == ""


def test_without_a_terminal_there_is_a_line_now_and_then(clock, capsys):
    with output.progress_display() as tell:
        for k in range(101):
            tell("alpha", k / 100)
            clock[0] += 1.0
    said = capsys.readouterr().err.splitlines()
    assert said == ["alpha: 30%, 0:01:10 left", "alpha: 60%, 0:00:40 left", "alpha: 90%, 0:00:10 left"]
