import threading

import pytest

from polyida.show import plots, press, style
from polyida.show.press import KINDS, Press


@pytest.fixture
def two(monkeypatch):
    monkeypatch.setattr(press, "cores", lambda: 2)


@pytest.fixture
def here(monkeypatch):
    """The kinds that this process draws."""
    kinds = []
    monkeypatch.setattr(press, "rendered", lambda made, kind: kinds.append(kind) or style.rendered(made, kind))
    return kinds


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_the_other_process_writes_what_this_one_would(two, here, runs, tmp_path):
    with Press() as given:
        given.ready()
        given.give("drift", plots.drift(runs))
        assert "drift" in given and "tip" not in given
        given.sheets["drift"][1].result()
        assert not names(tmp_path)
        given.write(tmp_path)
    assert not here and names(tmp_path) == {"drift.png", "drift.pdf"}
    for kind in KINDS:
        assert (tmp_path / f"drift.{kind}").read_bytes() == style.save(plots.drift(runs), tmp_path / f"here.{kind}").read_bytes()
    assert given.process.returncode is not None


def test_each_figure_is_drawn_once_on_one_side(two, here, runs, tmp_path):
    with Press() as given:
        for name in "abcd":
            given.give(name, plots.energy(runs))
        there = [sent for _, sent in given.sheets.values()]
        given.write(tmp_path)
    assert len(here) == 2 * sum(sent.cancelled() for sent in there)
    assert names(tmp_path) == {f"{name}.{kind}" for name in "abcd" for kind in KINDS}


def test_what_cannot_go_there_is_drawn_here(two, here, runs, tmp_path):
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
        given.write(tmp_path)
    assert here == ["png", "pdf"] * 2 and len(names(tmp_path)) == 4


def test_one_core_draws_alone(monkeypatch, here, runs, tmp_path):
    monkeypatch.setattr(press, "cores", lambda: 1)
    with Press() as given:
        given.ready()
        given.give("energy", plots.energy(runs))
        assert given.process is None
        given.write(tmp_path)
    assert here == ["png", "pdf"] and len(names(tmp_path)) == 2


def test_what_a_figure_raises_is_raised_here(two, runs, tmp_path):
    made = plots.energy(runs)
    made.axes[0].set_title(r"$\nothing{$")
    with Press() as given, pytest.raises(ValueError, match="nothing"):
        given.give("wrong", made)
        given.sheets["wrong"][1].result()
        given.write(tmp_path)
    assert not names(tmp_path)


def test_what_else_the_other_process_says_is_no_figure(two, here, runs, tmp_path, monkeypatch):
    """A line before the answers, by a program that Python runs at its start: no answer may be taken for that to another figure."""
    monkeypatch.setattr(press, "START", f"print('N', flush=True); {press.START}")
    with Press() as given:
        given.ready()
        for name in "abcd":
            given.give(name, plots.energy(runs))
            given.sheets[name][1].result()
        given.write(tmp_path)
    for name in "abcd":
        assert (tmp_path / f"{name}.png").read_bytes() == style.save(plots.energy(runs), tmp_path / "here.png").read_bytes()
