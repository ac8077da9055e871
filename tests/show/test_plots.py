import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

import polyida as pi
from polyida.errors import InputError
from polyida.model import Model
from polyida.show import plates, plots
from polyida.show.figure_files import csv
from polyida.show.styles import save


def drawn(figure, kind=PolyCollection):
    return [item for axes in figure.axes for item in axes.collections if type(item) is kind]


def test_the_mesh_of_one_body_is_drawn_with_the_numbers_of_all(model):
    figure = plots.mesh(model)
    (cells,) = drawn(figure)
    assert "number" in csv(figure).splitlines()[0]
    assert len(cells.get_paths()) == max(body.mesh.n_cells for body in model.bodies)
    assert f"of {sum(body.mesh.n_cells for body in model.bodies)} polygons" in figure.axes[0].get_title()


def test_a_mesh_is_drawn_with_its_sections_or_with_a_value_of_each_cell():
    mesh = pi.mesh.rectangle(1.0, 0.2, cells=12, seed=1)
    axes = mesh.plot()
    assert {text.get_text() for text in axes.get_legend().get_texts()} == set(mesh.sections)
    ends = np.array(axes.collections[1].get_segments()).reshape(-1, 2)
    assert np.ptp(ends[:, 0]) == 0.0 and np.ptp(ends[:, 1]) == pytest.approx(0.2)  # "left" is the first section
    values = np.linspace(1.0, 2.0, mesh.n_cells)
    axes = mesh.plot(values, "density")
    assert np.array_equal(axes.collections[0].get_array(), values)
    assert "density" in [other.get_xlabel() or other.get_ylabel() for other in axes.figure.axes]
    with pytest.raises(InputError, match="12 finite numbers, one for each cell"):
        mesh.plot(values[:-1])


def test_a_scene_is_drawn_where_its_parts_are_before_it_is_assembled():
    scene = pi.Scene()
    crank = scene.add(pi.RigidBody.bar(0.3, 1.0, name="crank"))
    rod = scene.add(pi.Rigid(pi.Plate(pi.mesh.quads(1.0, 0.1, 4, 1), pi.Material(1e9, 0.3, 1e3), 0.01, name="rod", origin=(0.3, 0.02))))
    scene.add(pi.Revolute(pi.ground, crank.at("left"), name="hinge"))
    scene.add(pi.AngleMotor(pi.ground, crank.at("left"), lambda t: t, name="motor"))
    scene.add(pi.Revolute(crank.at("right"), rod.section("left"), name="pin"))
    scene.add(pi.SpringDamper(rod.section("right"), pi.ground.at((1.5, 0.3)), stiffness=100.0, name="spring"))
    scene.add(pi.TorsionSpring(pi.ground.at((0.3, 0.0)), rod.section("left"), stiffness=1.0, name="torsion"))
    scene.add(pi.PointLoad(rod.section("right"), (0.0, -1.0), name="weight"))
    axes = scene.plot()
    collections = [lines for lines in axes.collections if isinstance(lines, LineCollection)]
    segments = np.concatenate([np.array(lines.get_segments())[:, :2] for lines in collections])
    pin, spring = crank.at("right").point, rod.section("right").point
    gap = np.array([pin, rod.section("left").point])
    assert np.abs(segments - gap).max(axis=(1, 2)).min() < 1e-12 < np.ptp(gap, axis=0).max()  # the joint is open, and drawn so
    for end in (spring, (1.5, 0.3)):
        assert np.abs(segments - end).max(axis=2).min() < 1e-12
    names = ", ".join(text.get_text() for text in axes.texts).split(", ")
    assert sorted(names) == sorted(scene.parts)
    assert axes.dataLim.x1 >= 1.5 and axes.get_aspect() == 1.0


def test_deformed_plates_stand_where_the_run_has_them_in_the_colour_of_their_stress(run):
    cells = drawn(plots.deformed(run, times=[0.0, 0.021, 0.04]))
    assert len(cells) == 3
    assert np.asarray(cells[-1].get_array()) == pytest.approx(run.von_mises(-1) / 1e3)
    corners = np.concatenate([path.vertices[:-1] for path in cells[-1].get_paths()])
    nodes, _ = plates.connectivity(run.model)
    assert corners == pytest.approx(run.node_positions(-1)[nodes])
    assert len({cell.get_clim() for cell in cells}) == 1


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


def test_one_run_alone_shows_its_coordinates(run):
    for axis, values in zip(plots.tip({"alpha": run}).axes, run.position("tip").T):
        assert axis.lines[0].get_ydata() == pytest.approx(values)


def test_drift_is_the_largest_of_each_interval(runs):
    for axis, kind in zip(plots.drift(runs).axes, ("drift", "velocity_drift")):
        for line, run in zip(axis.lines, runs.values(), strict=True):
            size, (t, drawn) = np.maximum(getattr(run, kind), plots.SMALLEST_DRIFT), line.get_data()
            ends = np.linspace(0, run.t[-1] * (1 + 1e-12), plots.INTERVALS + 1)
            parts = [size[(run.t >= low) & (run.t < high)] for low, high in zip(ends, ends[1:])]
            assert drawn == pytest.approx([part.max() for part in parts if len(part)]) and set(t) <= set(run.t)
    assert len({line.get_marker() for line in axis.lines}) == len({line.get_markersize() for line in axis.lines}) == len(runs)


def test_reactions_have_a_panel_a_component_and_say_the_unit(runs):
    figure = plots.reactions(runs, ["elbow", "elbow motor"])
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_visible()]
    assert labels == ["force x, N", "force y, N", "torque, N m"]
    titles = [axes.get_title() for axes in figure.axes if axes.get_visible()]
    assert titles == ["elbow, force x", "elbow, force y", "elbow motor, torque"]


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


def test_equal_figures_give_equal_files(runs, tmp_path):
    first, second = (save(plots.energy(runs), tmp_path / f"{name}.png").read_bytes() for name in "ab")
    assert first == second


def test_a_model_without_plates_is_refused():
    with pytest.raises(InputError, match="no plates"):
        plots.mesh(Model())
