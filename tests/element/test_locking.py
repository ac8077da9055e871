"""Near nu = 1/2 in plane strain: elements that lock say so, and the remedy that they name does not."""

import warnings

import pytest

import polyida as pi

LENGTH, HEIGHT, THICKNESS, E = 1.0, 0.1, 0.01, 1e7


def stiffness(element, nu, mesh):
    """Timoshenko's tip deflection of a cantilever in plane strain, over the computed one."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(mesh, pi.Material(E, nu, 1e3, "strain"), THICKNESS, element=element, name="beam"))
    scene.add(pi.Clamp(plate.section("left")))
    tip = plate.section("right")
    scene.add(pi.PointLoad(tip, (0.0, -1e-5)))
    model = scene.build()
    q = pi.static(model).q
    bending = LENGTH**3 / 3 / (E / (1 - nu**2) * THICKNESS * HEIGHT**3 / 12)
    shear = LENGTH / (5 / 6 * E / 2 / (1 + nu) * THICKNESS * HEIGHT)
    return -1e-5 * (bending + shear) / (tip.weights @ q.reshape(-1, 2)[tip.nodes][:, 1])


@pytest.mark.parametrize(
    "mesh", [pi.mesh.rectangle(LENGTH, HEIGHT, 90, seed=1), pi.mesh.quads(LENGTH, HEIGHT, 40, 4)], ids=["polygons", "quads"]
)
def test_the_virtual_element_does_not_lock(mesh):
    for nu in (0.3, 0.45, 0.499, 0.49999):
        with warnings.catch_warnings(action="error"):
            assert stiffness("virtual", nu, mesh) == pytest.approx(1.0, abs=0.02)


def test_elements_that_lock_say_so_and_name_plate_and_remedy():
    mesh = pi.mesh.rectangle(LENGTH, HEIGHT, 90, seed=1)
    with pytest.warns(pi.LockingWarning, match='beam: nu = 0.499 in plane strain .* use element="virtual"') as said:
        assert stiffness("wachspress", 0.499, mesh) > 2.0, "it does lock: no false alarm"
    assert len(said) == 1 and said[0].filename == __file__
    with pytest.warns(pi.LockingWarning, match="virtual elements of 3 corners"):
        stiffness("virtual", 0.46, pi.mesh.triangles(LENGTH, HEIGHT, 10, 1))
