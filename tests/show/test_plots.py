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


def test_tip_shows_the_first_path_and_what_the_others_are_away_from_it(runs):
    *history, path = plots.tip(runs).axes
    first, other = runs["generalized-alpha"], runs["IDA"]
    assert [line.get_xydata() == pytest.approx(first.position("tip")) for line in path.lines] == [True]
    for axis, k in zip(history, (0, 1), strict=True):
        (line,) = axis.lines
        assert line.get_label() == "IDA" and line.get_color() != path.lines[0].get_color()
        at = np.interp(other.t, first.t, first.position("tip")[:, k])
        bent = np.abs(np.diff(first.position("tip")[:, k], 2)).max() / 8  # a chord is no farther from a cubic than this
        assert line.get_ydata() == pytest.approx(other.position("tip")[:, k] - at, abs=1.5 * bent)
    assert np.abs(history[0].lines[0].get_ydata()).max() < 1e-5


def test_between_its_frames_the_first_run_is_as_exact_as_its_frames(model):
    """A run against itself with half the frames: what is left is of fourth order in the time between them."""
    run = pi.solve(model, 0.04, pi.GeneralizedAlpha(h=1e-4))
    few = pi.solve(model, 0.04, pi.GeneralizedAlpha(h=1e-4), output=run.t[::8])
    away = max(np.abs(axes.lines[0].get_ydata()).max() for axes in plots.tip({"few": few, "all": run}).axes[:2])
    chord = max(np.abs(np.interp(run.t, few.t, few.position("tip")[:, k]) - run.position("tip")[:, k]).max() for k in (0, 1))
    assert away < 1e-2 * chord


def test_one_run_alone_shows_its_coordinates(run):
    for axis, values in zip(plots.tip({"alpha": run}).axes, run.position("tip").T):
        assert axis.lines[0].get_ydata() == pytest.approx(values)


def test_a_colour_of_the_energy_is_a_run_in_both_panels(runs):
    of_parts, of_runs = plots.energy(runs).axes
    assert {line.get_color() for line in of_parts.lines} == {of_runs.lines[0].get_color()}
    assert len({line.get_marker() for line in of_parts.lines}) == len(of_parts.lines) == 4
    assert len({line.get_color() for line in of_runs.lines}) == len(runs)


def test_drift_is_the_largest_of_each_interval(runs):
    for axis, kind in zip(plots.drift(runs).axes, ("drift", "velocity_drift")):
        for line, run in zip(axis.lines, runs.values(), strict=True):
            size, (t, drawn) = np.maximum(getattr(run, kind), plots.LEAST), line.get_data()
            ends = np.linspace(0, run.t[-1] * (1 + 1e-12), plots.INTERVALS + 1)
            parts = [size[(run.t >= low) & (run.t < high)] for low, high in zip(ends, ends[1:])]
            assert drawn == pytest.approx([part.max() for part in parts if len(part)]) and set(t) <= set(run.t)
    assert len({line.get_marker() for line in axis.lines}) == len({line.get_markersize() for line in axis.lines}) == len(runs)


def test_the_key_of_a_mesh_says_what_its_shades_mean(model):
    made = plots.mesh(model)
    (cells,), (key,) = drawn(made), made.legends
    corners = np.diff(plates.connectivity(model)[1])
    meant = {tuple(patch.get_facecolor()): text.get_text() for patch, text in zip(key.get_patches(), key.get_texts(), strict=True)}
    for colour, count in zip(cells.get_facecolors(), corners, strict=True):
        assert str(min(count, 7)) in meant[tuple(colour)]


@pytest.mark.parametrize("width", [2.0, 3.0, 6.4])
def test_no_label_is_cut_off(run, scenes, width):
    """A motion that is flat and one that is high."""
    scene, upper, lower = scenes.pair()
    scene.add(pi.Clamp(pi.ground.at((0.0, 0.0)), upper.section("left"), name="wall"))
    for shown in (run, pi.solve(scene.build(), 0.5, pi.GeneralizedAlpha(h=5e-3))):
        made = plots.deformed(shown, width=width)
        rendered(made, "png")
        found, (width, height) = made.get_tightbbox(), made.get_size_inches()
        assert found.x0 >= 0 and found.y0 >= 0 and found.x1 <= width and found.y1 <= height


def test_reactions_have_a_panel_a_component_and_say_the_unit(runs):
    figure = plots.reactions(runs, ["elbow", "elbow motor"])
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_visible()]
    assert labels == ["force x, N", "force y, N", "torque, N m"]


def test_reactions_say_what_rows_do_to_b(scenes):
    """A joint of one's own with one row has the force along it; a clamp between plates force and moment, as a weld."""

    class Slot(pi.Joint):
        def rows(self):
            return [pi.cross(self.a.d, self.b.x - self.a.x)]

    scene, upper, lower = scenes.pair()
    scene.add(Slot(pi.ground.at((0.0, 0.0)), upper.section("left"), name="rail"))
    scene.add(pi.Clamp(upper.section("right"), lower.section("left"), name="weld"))
    run = pi.solve(scene.build(), 2e-3, pi.GeneralizedAlpha(h=1e-3))
    labels = [axes.get_ylabel() for axes in plots.reactions({"alpha": run}, ["rail", "weld"]).axes if axes.get_visible()]
    assert labels == ["force, N", "force x, N", "force y, N", "torque, N m"]


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


def test_long_labels_stand_below_each_other(runs):
    named = {f"{label} of a name that is as long as a folder and a file": run for label, run in runs.items()}
    for made in (plots.energy(named), plots.drift(named), plots.tip(named)):
        rendered(made, "png")
        found = made.get_tightbbox()
        assert found.x0 >= 0 and found.x1 <= made.get_figwidth()
