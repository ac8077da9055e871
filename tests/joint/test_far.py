"""Where a scene lies says nothing about how it moves: translated by 1e6 m, every path is the same, moved."""

import numpy as np
import pytest

import polyida as pi

FAR = np.array([1234567.8, -765432.1])
SAME = 1e-9 + 2 * np.finfo(float).eps * FAR.max()  # m: and the round-off of the place itself


@pytest.fixture(scope="module")
def uneven():
    """Nodes of the short edges unevenly spaced: the weights of their turning sum to zero by no symmetry."""
    even = pi.mesh.quads(1.0, 0.1, 6, 3)
    x, y = even.points.T
    return pi.mesh.PolygonMesh(np.column_stack([x, y + 4 * (y**2 - 0.05**2)]), even.nodes, even.offsets, even.sections)


def moved(mesh, shift):
    return pi.mesh.PolygonMesh(mesh.points + shift, mesh.nodes, mesh.offsets, mesh.sections)


def ring(shift=(0.0, 0.0), sectors=12):
    """A round plate with a round hole of regular rims: its second moments are equal in all directions."""
    angle = 2 * np.pi * np.arange(sectors) / sectors
    points = np.concatenate([r * np.column_stack([np.cos(angle), np.sin(angle)]) for r in (0.5, 1.0)])
    k, ahead = np.arange(sectors), (np.arange(sectors) + 1) % sectors
    corners = np.stack([k, k + sectors, ahead + sectors, ahead], axis=1)
    return pi.mesh.PolygonMesh(points + shift, corners.ravel(), np.arange(0, 4 * sectors + 1, 4), {"rim": k})


LINEAR_OR_TURNED = ("revolute", "revolute, ground as b", "clamp to ground", "clamp, ground as a", "clamp between")
LINEAR_OR_TURNED += ("motor to ground", "motor, ground as b", "motor between")
ALPHA = pi.GeneralizedAlpha(h=2e-3)
IDA = pi.IDA(rtol=1e-9, max_order=5)  # below what is compared, so that a step more or less does not show; few steps in spite of it
CASES = [(kind, method) for kind in ("revolute", "clamp between", "motor between") for method in (IDA, pi.RadauIIA())]
CASES += [
    (kind, ALPHA) for kind in (*LINEAR_OR_TURNED, "prismatic", "prismatic to ground", "slot", "distance", "weld", "weld to ground", "path")
]


@pytest.mark.parametrize(
    "kind, integrator", CASES, indirect=["kind"], ids=lambda case: case if isinstance(case, str) else type(case).__name__
)
def test_a_scene_far_away_moves_as_one_at_the_origin(kind, integrator, scenes, uneven):
    angle = pi.profile.quintic(0.0, 0.3, duration=0.1)

    def path(**options):
        model = scenes.jointed(kind, angle, bend=0.0, **options).build()
        run = pi.solve(model, 0.03, integrator)
        assert run.success
        return run.position("tip")[-1]

    near = path(mesh=uneven)
    assert np.abs(path(mesh=uneven, origin=FAR) - FAR - near).max() < SAME, "plates placed by their origin"
    assert np.abs(path(mesh=moved(uneven, FAR)) - FAR - near).max() < SAME, "meshes drawn far away"


def test_weights_of_a_section_are_those_at_the_origin(scenes, uneven):
    for mesh, section in ((uneven, "left"), (ring(), "rim")):
        near = scenes.plate("near", mesh=mesh).section(section)
        for far in (scenes.plate("far", mesh=mesh, origin=FAR), scenes.plate("far", mesh=moved(mesh, FAR))):
            far = far.section(section)
            assert abs(far.turn_weights.sum()) < 1e-14 and abs(np.linalg.norm(far.direction) - 1.0) < 1e-14
            assert np.abs(far.turn_weights - near.turn_weights).max() < 1e-6  # m: the corners' round-off over their distance
            assert np.abs(far.point - near.point - FAR).max() < SAME


def test_round_off_of_phi_is_that_of_distances_within_the_model(scenes):
    from polyida.integrate.sizes import extent

    near, far = (scenes.jointed("motor between", origin=origin).build() for origin in ((0.0, 0.0), FAR))
    q = np.zeros(near.n)
    assert extent(far, q) == pytest.approx(extent(near, q))


@pytest.mark.parametrize("bend", [0.0, 0.3, -2.7, np.pi / 2])
def test_phi_at_rest_is_zero_to_the_last_bit(kind, bend, scenes, uneven):
    model = scenes.jointed(kind, bend=bend, origin=FAR, mesh=uneven).build()
    assert not model.phi(0.0, np.zeros(model.n)).any()
