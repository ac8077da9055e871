import threading

import pytest

from polyida.show import plots, press, style
from polyida.show.press import KINDS, Press, csv


@pytest.fixture
def two(monkeypatch):
    monkeypatch.setattr(press, "cores", lambda: 2)


@pytest.fixture
def here(monkeypatch):
    """The kinds that this process draws."""
    kinds = []
    monkeypatch.setattr(press, "rendered", lambda made, kind: kinds.append(kind) or style.rendered(made, kind))
    return kinds


DRAWN = {*KINDS, "csv"}


def test_the_other_process_gives_what_this_one_would(two, here, runs):
    with Press() as given:
        given.ready()
        given.give("drift", plots.drift(runs))
        assert "drift" in given and "tip" not in given
        given.sheets["drift"][1].result()
        files = given.files()
    assert not here and set(files) == {"drift"} and set(files["drift"]) == DRAWN
    own = plots.drift(runs)
    assert files["drift"] == {kind: style.rendered(own, kind) for kind in KINDS} | {"csv": csv(own).encode()}
    assert given.process.returncode is not None


def test_each_figure_is_drawn_once_on_one_side(two, here, runs):
    with Press() as given:
        for name in "abcd":
            given.give(name, plots.energy(runs))
        there = [sent for _, sent in given.sheets.values()]
        files = given.files()
    assert len(here) == len(KINDS) * sum(sent.cancelled() for sent in there)
    assert {name: set(kinds) for name, kinds in files.items()} == dict.fromkeys("abcd", DRAWN)


def test_what_cannot_go_there_is_drawn_here(two, here, runs):
    with Press() as given:
        given.ready()
        made = plots.energy(runs)
        made.kept = threading.Lock()
        given.give("locked", made)
        given.sheets["locked"][1].result()
        given.process.kill()
        given.process.wait()
        given.give("late", plots.energy(runs))
        given.sheets["late"][1].result()
        assert set(given.files()) == {"locked", "late"}
    assert here == [*KINDS] * 2


def test_one_core_draws_alone(monkeypatch, here, runs):
    monkeypatch.setattr(press, "cores", lambda: 1)
    with Press() as given:
        given.ready()
        given.give("energy", plots.energy(runs))
        assert given.process is None
        assert set(given.files()) == {"energy"}
    assert here == [*KINDS]


def test_what_a_figure_raises_is_raised_here(two, runs):
    made = plots.energy(runs)
    made.axes[0].set_title(r"$\nothing{$")
    with Press() as given, pytest.raises(ValueError, match="nothing"):
        given.give("wrong", made)
        given.sheets["wrong"][1].result()
        given.files()


def test_what_else_the_other_process_says_is_no_figure(two, here, runs, monkeypatch):
    """A line before the answers, by a program that Python runs at its start: no answer may be taken for that to another figure."""
    monkeypatch.setattr(press, "START", f"print('N', flush=True); {press.START}")
    with Press() as given:
        given.ready()
        for name in "abcd":
            given.give(name, plots.energy(runs))
            given.sheets[name][1].result()
        files = given.files()
    own = style.rendered(plots.energy(runs), "png")
    assert [files[name]["png"] == own for name in "abcd"] == [True] * 4
