import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PolyCollection

import polyida as pi
from polyida.errors import InputError
from polyida.model import Model
from polyida.show import plates, plots
from polyida.show.style import rendered, save


def drawn(figure, kind=PolyCollection):
    return [item for axes in figure.axes for item in axes.collections if type(item) is kind]


def test_mesh_draws_every_polygon(model):
    (cells,) = drawn(plots.mesh(model))
    assert len(cells.get_paths()) == sum(body.mesh.n_cells for body in model.bodies)


def test_deformed_plates_stand_where_the_run_has_them_in_the_colour_of_their_stress(run):
    cells = drawn(plots.deformed(run, times=[0.0, 0.021, 0.04]))
    assert len(cells) == 3
    assert np.asarray(cells[-1].get_array()) == pytest.approx(run.von_mises(-1) / 1e3)
    corners = np.concatenate([path.vertices[:-1] for path in cells[-1].get_paths()])
    nodes, _ = plates.connectivity(run.model)
    assert corners == pytest.approx(run.node_positions(-1)[nodes])
    assert len({cell.get_clim() for cell in cells}) == 1


def test_more_polygons_than_can_be_told_apart_are_one_image_in_a_pdf(run, monkeypatch):
    whole = plots.deformed(run)
    monkeypatch.setattr(plots, "DISTINCT", 100)
    fine = plots.deformed(run)
    images = [rendered(made, "pdf").count(b"/Subtype /Image") for made in (whole, fine)]
    assert images[1] == images[0] + 2  # its colours and what shines through; the colorbar is one as well
    assert rendered(fine, "png") == rendered(whole, "png")


def test_tip_shows_the_path_of_every_run(runs):
    path = plots.tip(runs).axes[-1]
    for line, run in zip(path.lines, runs.values(), strict=True):
        assert line.get_xydata() == pytest.approx(run.position("tip"))


def test_reactions_have_a_panel_a_component_and_say_the_unit(runs):
    figure = plots.reactions(runs, ["elbow", "elbow motor"])
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_visible()]
    assert labels == ["force x, N", "force y, N", "torque, N m"]


def test_reactions_say_what_their_own_rows_are(scenes):
    """One row need not be a motor's; the directions of a clamp have moments."""

    class Slot(pi.Joint):
        def rows(self):
            return [pi.cross(self.a.d, self.b.x - self.a.x)]

    scene, upper, lower = scenes.pair()
    scene.add(Slot(pi.ground.at((0.0, 0.0)), upper.section("left"), name="rail"))
    scene.add(pi.Clamp(upper.section("right"), lower.section("left"), name="weld"))
    run = pi.solve(scene.build(), 2e-3, pi.GeneralizedAlpha(h=1e-3))
    labels = [axes.get_ylabel() for axes in plots.reactions({"alpha": run}, ["rail", "weld"]).axes if axes.get_visible()]
    assert labels == ["multiplier 0", "force x, N", "force y, N", "torque x, N m", "torque y, N m"]


def test_reactions_of_many_joints_are_cut_at_the_limit(runs):
    assert len(plots.reactions(runs, ["shoulder", "elbow"], limit=3).axes) == 4


def test_lines_differ_in_dash_as_well_as_in_colour(runs):
    for figure in (plots.energy(runs), plots.drift(runs), plots.coordinates(runs)):
        first, second = figure.axes[-1].lines[:2]
        assert first.get_color() != second.get_color() and first.get_linestyle() != second.get_linestyle()


def test_drawing_leaves_matplotlib_as_it_was(runs, tmp_path):
    before = dict(matplotlib.rcParams)
    save(plots.drift(runs), tmp_path / "drift.pdf")
    assert dict(matplotlib.rcParams) == before


def test_equal_figures_give_equal_files(runs, tmp_path):
    first, second = (save(plots.energy(runs), tmp_path / f"{name}.png").read_bytes() for name in "ab")
    assert first == second


def test_the_nearest_frame_is_found_without_looking_at_all_pairs():
    import tracemalloc
    from types import SimpleNamespace

    draw = np.random.default_rng(0)
    for count in range(1, 9):
        t, at = np.sort(draw.integers(0, 8, count) / 2), draw.integers(-4, 24, 40) / 4  # equal times, ties, beyond the ends
        assert np.array_equal(plates.frames_at(SimpleNamespace(t=t), at), np.abs(t[None] - at[:, None]).argmin(axis=1))
    t = np.linspace(0.0, 1.0, 20_000)
    tracemalloc.start()
    plates.spread(SimpleNamespace(t=t), 5_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2_000_000


def test_frames_are_spread_in_time_and_come_once(run):
    frames = plates.spread(run, 5)
    assert frames[0] == 0 and frames[-1] == len(run.t) - 1 and len(frames) == 5
    assert np.diff(run.t[frames]) == pytest.approx(0.01)
    assert len(plates.spread(run, 10_000)) == len(run.t)
    with pytest.raises(InputError, match="frames = 0"):
        plates.spread(run, 0)


def test_a_model_without_plates_is_refused():
    with pytest.raises(InputError, match="no plates"):
        plots.mesh(Model())


def test_reactions_are_labelled_by_their_components():
    """A guide has two rows and three components: force x, force y and a moment."""
    scene = pi.Scene(gravity=(1.0, -9.81))
    slider = scene.add(pi.RigidBody(1.0, 0.1, {"B": (0.0, 0.0)}))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0)), slider.at("B"), name="guide"))
    run = pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))
    made = plots.reactions({"alpha": run}, ["guide"])
    assert [axes.get_ylabel() for axes in made.axes[:3]] == ["force x, N", "force y, N", "torque, N m"]
