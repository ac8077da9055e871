"""Pictures of modes and responses: what is drawn is where the model is, at a visible size, and what is not there is not drawn."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

import polyida as pi
from polyida.show.plates import AMPLITUDE
from polyida.show.styles import figure, rendered

MESH = pi.mesh.quads(1.0, 0.1, 10, 2)
RUBBER = pi.Material(50e6, 0.3, 1100.0)


def mechanism(body=lambda plate: plate):
    """(model, modes) of a rigid crank with a plate on it, in its rest."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    crank = scene.add(pi.RigidBody(0.4, 1e-3, {"O": (0.0, 0.0), "A": (0.0, -0.5)}, origin=(0.0, 0.0), name="crank"))
    rod = scene.add(body(pi.Plate(MESH, RUBBER, 0.01, origin=(0.0, -0.5), angle=-np.pi / 2, name="rod")))
    scene.add(pi.Revolute(pi.ground, crank.at("O")))
    scene.add(pi.Revolute(crank.at("A"), rod.section("left")))
    model = scene.build()
    return model, pi.modes(model, pi.static(model), count=min(3, model.n - model.m))


def cells(axes):
    (drawn,) = [thing for thing in axes.collections if isinstance(thing, PolyCollection)]
    return np.concatenate([path.vertices[:-1] for path in drawn.get_paths()])


@pytest.mark.parametrize("body", [lambda plate: plate, lambda plate: pi.Reduced(plate, modes=2), pi.Rigid])
def test_a_mode_is_drawn_at_its_shape_and_a_visible_size(body):
    model, found = mechanism(body)
    axes = found.plot(0).axes[0]
    rest = model.drawn_points + model.nodal(found.state.q)
    nodes = np.concatenate([drawn.mesh.nodes + drawn.nodes.start for drawn in model.drawn])
    way, shape = cells(axes) - rest[nodes], model.nodal(found.shapes[0])[nodes]
    factor = np.sum(way * shape) / np.sum(shape**2)
    assert np.allclose(way, factor * shape, atol=1e-9) and factor > 0
    points = np.concatenate([rest, [[0.0, 0.0]]])
    assert np.hypot(*way.T).max() == pytest.approx(AMPLITUDE * np.linalg.norm(np.ptp(points, axis=0)), rel=1e-2)
    assert axes.get_title() == f"mode 1: {found.frequencies[0]:.4g} Hz"
    segments = [thing.get_segments() for thing in axes.collections if isinstance(thing, LineCollection)]
    assert sum(len(found) == 1 for found in segments) == 2  # the crank, at rest and moved


def test_several_modes_stand_in_panels_of_one_size():
    _, found = mechanism()
    made = found.plot()
    assert [axes.get_title()[:6] for axes in made.axes if axes.get_visible()] == ["mode 1", "mode 2", "mode 3"]
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in made.axes if axes.get_visible()}) == 1
    assert len(rendered(found.plot([2, 0]), "png")) > 5000


def test_on_axes_of_one_s_own_and_twice_as_large():
    _, found = mechanism()
    made, panels = figure(ncols=2)
    rest = found.model.drawn_points + found.model.nodal(found.state.q)
    nodes = np.concatenate([drawn.mesh.nodes for drawn in found.model.drawn])
    assert found.plot(1, axes=panels[0]) is made and found.plot(1, scale=2.0, axes=panels[1]) is made
    one, two = (cells(axes) - rest[nodes] for axes in panels)
    assert np.allclose(2 * one, two)


def test_a_model_of_one_s_own_is_drawn_as_bars():
    class Pair(pi.Model):
        n, m = 2, 0

        def mass(self, q):
            return np.eye(2)

        def force(self, t, q, v):
            return np.array([[2.0, -1.0], [-1.0, 2.0]]) @ q

    found = pi.modes(Pair(), count=2)
    bars = [bar.get_height() for bar in found.plot(1).axes[0].patches]
    assert bars == pytest.approx(found.shapes[1])


def test_a_response_is_drawn_where_there_is_one():
    scene = pi.Scene()
    plate = scene.add(pi.Plate(MESH, RUBBER, 0.01))
    scene.add(pi.Clamp(plate.section("left")))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), 0.0, name="push"))
    found = pi.frequency_response(scene.build(), None, "push", {"tip": "push"}, np.linspace(1.0, 5.0, 9))
    upper, lower = found.plot().axes
    across, along = upper.lines[1].get_ydata(), upper.lines[0].get_ydata()
    assert across == pytest.approx(found.amplitude[:, 1]) and np.isnan(along).all() and upper.get_yscale() == "log"
    assert lower.lines[1].get_ydata() == pytest.approx(np.degrees(found.phase[:, 1]))
    assert len(rendered(found.plot(), "png")) > 5000


def test_figures_of_modes_and_responses_have_the_width_of_the_style_around():
    scene = pi.Scene()
    plate = scene.add(pi.Plate(MESH, RUBBER, 0.01))
    scene.add(pi.Clamp(plate.section("left")))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), 0.0, name="push"))
    model = scene.build()
    found, answer = pi.modes(model, count=3), pi.frequency_response(model, None, "push", {"tip": "push"}, np.linspace(1.0, 5.0, 9))
    assert [plot().get_figwidth() for plot in (found.plot, lambda: found.plot(0), answer.plot)] == [6.4, 5.0, 6.4]
    with pi.show.style("paper"):
        for made in (found.plot(), found.plot(0), answer.plot()):
            assert made.get_figwidth() == 3.3
            assert {axes.get_subplotspec().colspan.stop for axes in made.axes} == {1}  # one below the other
    with pi.show.style("paper", columns=2):
        assert found.plot().get_figwidth() == 6.9
