"""Forces through a cut: those of statics on a cantilever, of a spinning bar, and Newton's law of the part ahead of any cut."""

import numpy as np
import pytest

import polyida as pi

MESHES = {"quads": pi.mesh.quads(1.0, 0.1, 20, 4, origin=(0.0, -0.05)), "polygons": pi.mesh.rectangle(1.0, 0.1, cells=80, seed=1)}
CUTS = (0.1, 0.37, 0.5, 0.9)


@pytest.fixture(params=MESHES)
def mesh(request):
    return MESHES[request.param]


def bar(mesh, gravity=(0.0, 0.0), element="wachspress", origin=(0.0, 0.0), angle=0.0, **material):
    """(scene, bar along the x axis of its mesh)."""
    scene, material = pi.Scene(gravity), {"E": 50e6, "nu": 0.3, "rho": 1100.0} | material
    return scene, scene.add(pi.Plate(mesh, pi.Material(**material), 0.01, element=element, origin=origin, angle=angle, name="bar"))


def middle(plate):
    """The y of its axis in its mesh."""
    return float(plate.mesh.points[plate.section("left").nodes, 1].mean())


def vector(cut):
    """The force ahead on behind in the axes of the scene."""
    return cut.normal * cut.direction + cut.shear * np.array([-cut.direction[1], cut.direction[0]])


def cross(x, f):
    return x[..., 0] * f[..., 1] - x[..., 1] * f[..., 0]


@pytest.mark.parametrize("element", ["wachspress", "virtual"])
def test_a_cantilever_under_a_tip_load(mesh, element):
    """Bent by a third of its length: force and moment of every cut are those of the load, and of the clamp."""
    scene, plate = bar(mesh, element=element, origin=(0.3, 0.2), angle=0.4)
    scene.add(pi.Clamp(plate.section("left"), name="clamp"))
    scene.add(pi.PointLoad(plate.section("right"), (1.0, -2.0), name="tip"))
    model = scene.build()
    run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-3), state=pi.static(model))
    for x in CUTS:
        cut = run.section_forces("bar", at=(x, middle(plate)), frame=0)
        assert np.allclose(vector(cut), [1.0, -2.0], atol=1e-9)
        assert cut.moment == pytest.approx(cross(run.position("tip")[0] - cut.point, np.array([1.0, -2.0])), abs=1e-9)
    near = run.section_forces("bar", at=(1e-3, middle(plate)), frame=0)
    assert np.allclose(vector(near), run.reaction("clamp")[0].reshape(-1, 2).sum(axis=0), atol=1e-8)


def test_weight_of_a_cantilever(mesh):
    """The force is the weight ahead of the very line of the cut, wherever cells end; the moment of a stiff one is square in x."""
    scene, plate = bar(mesh, gravity=(2.0, -9.81), E=5e9)
    scene.add(pi.Clamp(plate.section("left")))
    model = scene.build()
    run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-3), state=pi.static(model))
    for x in (1e-3, *CUTS, 0.522, 0.999):
        cut, weight = run.section_forces(plate, (x, middle(plate)), frame=0), 1.1 * (1 - x)
        assert np.allclose(vector(cut), np.array([2.0, -9.81]) * weight, rtol=1e-8)
        assert cut.moment == pytest.approx(-9.81 * weight * (1 - x) / 2, rel=2e-3)


def test_of_a_spinning_bar(mesh):
    """`N = rho A omega^2 (L^2 - x^2) / 2`; stretching is damped away, the turn is not."""
    scene, plate = bar(mesh, E=5e9, viscosity=1e-3)
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    model = scene.build()
    arm = model.reference - plate.section("left").point
    run = pi.solve(model, 0.05, pi.RadauIIA(rtol=1e-7), v0=(5.0 * np.stack([-arm[:, 1], arm[:, 0]], axis=1)).ravel())
    for x in CUTS:
        cut = run.section_forces("bar", (x, middle(plate)))
        assert cut.normal.shape == run.t.shape and cut.normal[-1] == pytest.approx(1.1 * 25.0 * (1 - x * x) / 2, rel=1e-4)
        assert abs(cut.shear[-1]) < 1e-4 and abs(cut.moment[-1]) < 1e-4


@pytest.mark.parametrize(
    "material, gravity", [({}, (0.0, -9.81)), ({"viscosity": 1e-4, "mass_damping": 1.0}, (pi.profile.sine(5.0, 20.0), -9.81))]
)
def test_action_is_reaction(material, gravity):
    """A falling bar, damped or not, cut askew while it bends: the free end and the hinged one tell the same, the moment with other sign."""
    scene, plate = bar(MESHES["polygons"], gravity=gravity, angle=0.3, **material)
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    run = pi.solve(scene.build(), 0.1, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-6), every=25)
    there, back = (run.section_forces("bar", (0.48, middle(plate)), way) for way in ((4.0, 3.0), (-4.0, -3.0)))
    size = np.abs([there.normal, there.shear]).max()
    assert np.abs(np.array([there.normal - back.normal, there.shear - back.shear, there.moment + back.moment])).max() < 1e-6 * size
    assert np.allclose(there.point, back.point, atol=1e-14) and np.allclose(there.direction, -back.direction, atol=1e-14)


def test_files_and_frames(run, file):
    again = pi.load(file, memory_limit=0)
    every, one = run.section_forces("lower", (0.5, 0.05)), again.section_forces("lower", (0.5, 0.05), frame=-1)
    for name in ("normal", "shear", "moment", "point", "direction"):
        assert np.allclose(getattr(every, name)[-1], getattr(one, name), rtol=1e-12)


def test_a_body_of_few_coordinates_is_none(scenes):
    scene = pi.Scene()
    scene.add(pi.Reduced(scenes.plate("few"), modes=2))
    scene.add(scenes.plate("full"))
    run = pi.solve(scene.build(), 1e-3, pi.GeneralizedAlpha(h=1e-3))
    assert run.section_forces("full", (0.5, 0.0)).normal.shape == (2,)
    with pytest.raises(pi.InputError, match="no full plate is called 'few'; known: 'full'"):
        run.section_forces("few", (0.5, 0.0))
