import pytest

from polyida.show import figure_files, plots, styles
from polyida.show.figure_files import KINDS, FigureWriter, csv


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(figure_files, "cores", lambda: 2)


@pytest.fixture
def rendered_here(monkeypatch):
    """The kinds that this process renders."""
    kinds = []
    monkeypatch.setattr(figure_files, "rendered", lambda figure, kind: kinds.append(kind) or styles.rendered(figure, kind))
    return kinds


ALL_KINDS = {*KINDS, "csv"}


def test_the_second_process_gives_the_same_files_and_its_errors_are_raised_here(two_cores, rendered_here, runs):
    wrong = plots.energy(runs)
    wrong.axes[0].set_title(r"$\nothing{$")
    with FigureWriter() as writer:
        writer.wait_until_ready()
        writer.add("drift", plots.drift(runs))
        assert set(writer.figures) == {"drift"}
        writer.futures["drift"].result()
        files = writer.files()
        assert not rendered_here and set(files) == {"drift"} and set(files["drift"]) == ALL_KINDS
        writer.add("wrong", wrong)
        assert writer.futures["wrong"].exception()
        with pytest.raises(ValueError, match="nothing"):
            writer.files()
    figure = plots.drift(runs)
    assert files["drift"] == {kind: styles.rendered(figure, kind) for kind in KINDS} | {"csv": csv(figure).encode()}


def test_with_one_core_this_process_renders(monkeypatch, rendered_here, runs):
    monkeypatch.setattr(figure_files, "cores", lambda: 1)
    with FigureWriter() as writer:
        writer.wait_until_ready()
        writer.add("energy", plots.energy(runs))
        assert writer.pool is None
        assert set(writer.files()) == {"energy"}
    assert rendered_here == [*KINDS]
