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
