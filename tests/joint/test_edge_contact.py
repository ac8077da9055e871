"""Contact with the edges of plates: mortar gaps of sections, points that face edges; patch test, balances, derivatives, wrong input."""

import numpy as np
import pytest

import polyida as pi
from polyida.io.scene_data import from_data, to_data

STEPS = pi.NonsmoothAlpha(h=1e-2, rho_inf=0.0)
PRESSURE = 2e4  # Pa


def plate(width, cells, y, name, x=0.0, viscosity=0.0, **motion):
    """A plate of soft material, 0.4 m high, its lower left corner at (x, y)."""
    material = pi.Material(E=1e6, nu=0.3, rho=1000.0, viscosity=viscosity)
    return pi.Plate(pi.mesh.quads(width, 0.4, cells, 2), material, 0.01, origin=(x, y + 0.2), name=name, **motion)


def stack(low_cells, high_cells, friction=0.0, gap=0.0):
    """Two plates of 1 m width above each other; the upper one is the first side of the contact "between"."""
    scene = pi.Scene()
    low, high = (
        scene.add(plate(1.0, n, y, name, viscosity=3e-2)) for name, n, y in (("low", low_cells, 0.0), ("high", high_cells, 0.4 + gap))
    )
    scene.add(pi.Contact(high.section("bottom"), low.section("top"), friction=friction, name="between"))
    return scene, low, high


@pytest.mark.parametrize("cells", [(7, 5), (20, 27)])
def test_patch(cells):
    """Two plates with unlike edges between a floor and a pressure: the stress is uniform, -p of the width at rest."""
    scene, low, high = stack(*cells)
    scene.add(pi.Contact(low.section("bottom"), pi.ground.at((0.0, 0.0)), name="floor"))
    scene.add(pi.EdgeTraction(high.section("top"), (0.0, -PRESSURE), pi.profile.quintic(0.0, 1.0, 1.0)))
    run = pi.solve(scene.build(), 2.5, STEPS)
    assert run.success, run.message
    stress = run.stress(-1) / PRESSURE
    assert np.abs(stress[:, 1] - stress[:, 1].mean()).max() < 1e-6 and np.abs(stress[:, [0, 2]]).max() < 1e-6
    for name in ("floor", "between"):
        assert np.abs(run.reaction(name)[-1] + [0.0, 0.01 * PRESSURE]).max() < 1e-6 * 0.01 * PRESSURE


def test_derivatives_and_balance():
    """phi_q is the derivative of closed gaps; forces of closed gaps are in balance, and rigid motions do not change gaps."""
    scene, *_ = stack(5, 7, friction=0.3)
    model, random = scene.build(), np.random.default_rng(0)
    q, v, lam, step = *random.standard_normal((2, model.n)), random.standard_normal(model.m), 1e-7
    closed = np.arange(0, model.m, 2)
    rate = (model.phi(0.0, step * v) - model.phi(0.0, -step * v))[closed] / (2 * step)
    assert np.abs(rate - model.phi_rate(0.0, 0.0 * q, v)[closed]).max() < 1e-5
    q = 1e-2 * q
    assert np.abs(model.phi_q(0.0, q) @ v - model.phi_rate(0.0, q, v)).max() < 1e-12
    x, force = model.reference + q.reshape(-1, 2), (model.phi_q(0.0, q).T @ lam).reshape(-1, 2)
    moment = np.sum(x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0])
    assert np.abs(force.sum(axis=0)).max() < 1e-12 and abs(moment + lam[1::2] @ model.phi(0.0, q)[closed]) < 1e-12  # slips across open gaps
    residual = model.residual(0.0, q, 0.0 * v, 0.0 * v, lam) - model.residual(0.0, q, 0.0 * v, 0.0 * v, 0.0 * lam)
    assert np.abs(residual - force.ravel()).max() < 1e-9 * np.abs(force).max()
    turned = x @ np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]]) + [0.3, -0.2] - model.reference
    assert np.abs(model.phi(0.0, turned.ravel()) - model.phi(0.0, q)).max() < 1e-12


@pytest.mark.parametrize("mass", [1.0, 0.1])
def test_plates_collide_and_slide(mass):
    """Nothing acts from outside: momenta stay, energy does not grow, no mean gap is negative, friction is within its cone."""
    scene = pi.Scene()
    low = scene.add(plate(1.0, 7, 0.0, "low", velocity=(0.0, 0.5)))
    high = scene.add(plate(0.5, 3, 0.41, "high", 0.1, velocity=(1.0, -0.5)))
    scene.add(pi.Contact(high.section("bottom"), low.section("top"), friction=0.3, contact_mass=mass, name="hit"))
    model = scene.build()
    for integrator, depth in ((pi.NonsmoothAlpha(h=1e-3, rho_inf=0.5, tolerance=1e-8), 1e-11), (pi.MoreauJean(h=1e-3), 2e-3)):
        run = pi.solve(model, 0.06, integrator)
        assert run.success and [one.name for one in run.events][0] == "hit", run.message
        assert np.abs(run.momentum - run.momentum[0]).max() < 1e-7 * run.momentum[0].max()
        assert np.diff(run.energy.total).max() < 2e-4 * run.energy.total[0]
        assert min(model.phi(t, q)[::2].min() for t, q in zip(run.t, run.q)) > -depth
        lam = np.asarray(run.lam)
        assert lam[:, ::2].max() <= 0.0 and (np.abs(lam[:, 1::2]) <= 0.3 * np.abs(lam[:, ::2]) + 1e-9).all()
        before = model.mass() @ run.v[0]
        impulse = (model.mass() @ run.v[-1] - before).reshape(-1, 2)[: low.mesh.n_nodes].sum(axis=0)
        assert np.abs(1e-3 * run.reaction("hit")[1:].sum(axis=0) - impulse).max() < 5e-3 * np.abs(impulse).max()


def test_points_face_edges():
    """A rigid body and a place of the ground hit the middle of a plate: the edge stops them; a point beside the edge passes."""
    scene = pi.Scene()
    beam = scene.add(plate(1.0, 6, 0.0, "beam", velocity=(0.0, 0.2)))
    ball = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.5, 0.41), velocity=(0.1, -1.0), name="ball"))
    away = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(1.1, 0.41), velocity=(0.0, -1.0), name="away"))
    for name, body in (("hit", ball), ("none", away)):
        scene.add(pi.Contact(body.at("c"), beam.section("top"), name=name))
    model = scene.build()
    run = pi.solve(model, 0.2, pi.NonsmoothAlpha(h=1e-3, rho_inf=0.5, tolerance=1e-8))
    assert run.success and {one.name for one in run.events} == {"hit"}, run.message
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-8
    edge = model.position(beam.section("top").each()[3], run.q)
    assert (run.position(ball.at("c"))[:, 1] - edge[:, 1]).min() > -2e-3 and run.position(away.at("c"))[-1, 1] == pytest.approx(0.21)


@pytest.mark.parametrize("x", [0.5, 0.501])
def test_a_plate_on_a_peg(x):
    """The peg presses a notch into the edge: it touches two edges there, and does not slip through their corner."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    beam = scene.add(plate(1.0, 6, 0.0, "beam", viscosity=3e-2))
    scene.add(pi.Contact(pi.ground.at((x, -0.001)), beam.section("bottom"), friction=0.3 if x > 0.5 else 0.0, name="peg"))
    run = pi.solve(scene.build(), 0.4, pi.NonsmoothAlpha(h=4e-3, rho_inf=0.0))
    assert run.success, run.message
    assert run.reaction("peg")[-1, 1] == pytest.approx(0.4 * 0.01 * 1000.0 * 9.81, rel=2e-2)


def test_wrong_input_and_files():
    scene, low, high = stack(5, 7)
    model = scene.build()
    with pytest.raises(pi.InputError, match="the contacts of between are with edges"):
        pi.solve(model, 0.1, pi.RadauIIA())
    parts, _ = from_data(*to_data(model)[:2])
    assert parts["between"].edges.others.shape == (5, 2)
    with pytest.raises(pi.InputError, match=r"between: its sides are 0\.01 m within each other"):
        stack(5, 7, gap=-0.01)[0].build()
    inner = high.node((0.43, 0.0)).nodes[0]
    with pytest.raises(pi.InputError, match="has no edge of the plate's rim"):
        pi.Contact(high.section([*high.section("bottom").nodes, inner]), low.section("top"))
    with pytest.raises(pi.InputError, match="turns by 90 degrees at node"):
        pi.Contact(high.section(np.union1d(high.section("left").nodes, high.section("bottom").nodes)), low.section("top"))


BOX = {"a": (-0.3, -0.1), "b": (0.3, -0.1), "c": (0.3, 0.1), "d": (-0.3, 0.1)}


def box(name, origin, mass=1.0, **motion):
    """A rigid box of 0.6 m x 0.2 m about its origin, with corners a to d."""
    return pi.RigidBody(mass=mass, inertia=mass * 0.4 / 12, points=BOX, origin=origin, name=name, **motion)


def test_a_box_slides_on_a_box():
    """Edge on edge of rigid bodies: two rows carry the weight, friction slows it down by mu g until it rests."""
    mu, speed, g = 0.3, 0.4, 10.0
    scene = pi.Scene(gravity=(0.0, -g))
    low, high = scene.add(box("low", (0.0, 0.0))), scene.add(box("high", (-0.1, 0.2), mass=2.0, velocity=(speed, 0.0)))
    scene.add(pi.Clamp(low.at("a"), name="held"))
    scene.add(pi.Contact(high.edges("a", "b"), low.edges("c", "d"), friction=mu, name="between"))
    run = pi.solve(scene.build(), 0.3, pi.NonsmoothAlpha(h=1e-3))
    assert run.success, run.message
    slides = np.minimum(run.t, speed / (mu * g))
    away = (run.t > 2e-3) & (np.abs(run.t - speed / (mu * g)) > 2e-3)
    assert run.position(high.at("a"))[:, 0] == pytest.approx(-0.4 + speed * slides - 0.5 * mu * g * slides**2, abs=1e-5)
    assert run.position(high.at("a"))[:, 1] == pytest.approx(0.1, abs=1e-9)
    force = np.where(run.t < speed / (mu * g), 2.0 * mu * g, 0.0)
    assert run.reaction("between")[away, 1] == pytest.approx(-2.0 * g, rel=1e-6)
    assert run.reaction("between")[away, 0] == pytest.approx(force[away], abs=2e-4)


def test_a_point_slides_off_a_tilted_box():
    """A point on edges moves as on a line through them up to their end, and falls beyond it."""
    angle, ways = -0.5, []
    for edges in (True, False):
        scene = pi.Scene(gravity=(0.0, -10.0))
        ramp = scene.add(box("ramp", (0.0, 0.0), angle=angle))
        place = np.array(ramp.at("d").point) + 0.3 * np.array([np.cos(angle), np.sin(angle)])
        ball = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=tuple(place), name="ball"))
        scene.add(pi.Clamp(ramp.at("a"), name="held"))
        scene.add(pi.Contact(ball.at("c"), ramp.edges("a", "b", "c", "d", "a") if edges else ramp.at("c"), friction=0.1, name="hit"))
        model = scene.build()
        run = pi.solve(model, 0.6, pi.NonsmoothAlpha(h=2e-3))
        assert run.success, run.message
        ways.append(run.position(ball.at("c")))
    leaves = np.sqrt(2 * 0.3 / (10.0 * (np.sin(0.5) - 0.1 * np.cos(0.5))))
    on = run.t < leaves - 2e-3
    assert np.abs(ways[0] - ways[1])[on].max() < 1e-9 and ways[0][-1, 1] < ways[1][-1, 1] - 0.1


HITS = {  # what falls on a plate
    "box": lambda: box("high", (0.5, 0.51), velocity=(0.2, -0.5)),
    "rigid": lambda: pi.Rigid(plate(0.5, 4, 0.41, "high", 0.2, velocity=(0.2, -0.5))),
    "reduced": lambda: pi.Reduced(plate(0.5, 4, 0.41, "high", 0.2, viscosity=3e-2, velocity=(0.2, -0.5)), modes=12),
}


@pytest.mark.filterwarnings("ignore:.*leave much out")
@pytest.mark.parametrize("kind, first, edges", [("box", True, 1), ("box", False, 5), ("rigid", True, 1), ("reduced", True, 4)])
def test_a_body_hits_a_plate(kind, first, edges):
    """Nothing acts from outside: momenta stay, energy does not grow, and no mean gap is negative, whichever is the first side."""
    scene, high = pi.Scene(), HITS[kind]()
    low = scene.add(plate(1.0, 5, 0.0, "low", viscosity=0.0 if kind == "box" else 3e-2, velocity=(0.0, 0.5)))
    scene.add(high)
    sides = high.edges("a", "b") if kind == "box" else high.section("bottom"), low.section("top")
    scene.add(pi.Contact(*sides[:: 1 if first else -1], friction=0.3, name="hit"))
    model = scene.build()
    run = pi.solve(model, 0.06, pi.NonsmoothAlpha(h=5e-4, rho_inf=0.5, tolerance=1e-8))
    assert run.success and run.events, run.message
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-6 * np.abs(run.momentum[0]).max()
    assert np.diff(run.energy.total).max() < 2e-4 * run.energy.total[0]
    rows = model.rows["hit"]
    assert min(model.phi(t, q)[rows][::2].min() for t, q in zip(run.t, run.q)) > -1e-11
    parts, _ = from_data(*to_data(model)[:2])
    assert parts["hit"].edges.edges.shape == (edges, 2)


def test_edges_of_bodies_in_files_and_wrong_ones():
    """A file keeps their points; each wrong input is named."""
    scene = pi.Scene()
    low, high = scene.add(box("low", (0.0, 0.0))), scene.add(box("high", (0.0, 0.3)))
    scene.add(pi.Contact(high.edges("a", "b"), low.edges("c", "d"), name="between"))
    parts, _ = from_data(*to_data(scene.build())[:2])
    assert parts["between"].b.corners == ("c", "d") and parts["between"].edges.others.shape == (1, 2)
    for names, message in (
        (("a",), "two points or more"),
        (("a", "b", "a", "b"), "each once"),
        (("a", "e"), "no attachment is called 'e'"),
        (("b", "a"), "lies on the right of 'b' to 'a'; give the points in reverse order"),
    ):
        with pytest.raises(pi.InputError, match=message):
            low.edges(*names)
    with pytest.raises(pi.InputError, match="turns by 90 degrees at b.*body.at"):
        pi.Contact(high.edges("a", "b", "c"), low.edges("c", "d"))


def test_assemble_opens_penetrated_edges():
    """Bodies that are drawn within each other are moved apart, by as little as possible, and touch."""
    scene = pi.Scene(gravity=(0.0, -10.0))
    low, high = scene.add(box("low", (0.0, 0.0))), scene.add(box("high", (0.1, 0.17), angle=0.05))
    soft = scene.add(plate(0.4, 2, 0.245, "soft"))
    scene.add(pi.Clamp(low.at("a"), name="held"))
    for name, side in (("left", "a"), ("right", "b")):
        scene.add(pi.Contact(high.at(side), low.edges("a", "b", "c", "d", "a"), friction=0.3, name=name))
    scene.add(pi.Contact(soft.section("bottom"), high.edges("c", "d"), friction=0.3, name="top"))
    with pytest.raises(pi.InputError, match="left.*within each other at rest"):
        scene.build()
    found = scene.assemble()
    assert found.open and found.gap > 0.01
    model = scene.build()
    gaps = model.phi(0.0, np.zeros(model.n))[[law.row for law in model.row_laws if law.is_contact]]
    assert gaps.min() > -1e-9 and np.sort(gaps)[1] < 1e-6
    assert pi.solve(model, 0.01, pi.NonsmoothAlpha(h=1e-3)).success


@pytest.mark.parametrize("kind", [lambda plate: plate, pi.Rigid], ids=["full", "rigid"])
@pytest.mark.parametrize("depth", [0.02, 0.25, 0.39])
def test_a_start_deep_within_the_other_plate_is_refused(kind, depth):
    """Cells are 0.1 m long, plates 0.4 m high; a plate behind the other one is allowed."""
    scene = pi.Scene()
    low, high = (scene.add(kind(plate(1.0, 10, y, name, x=y / 8))) for name, y in (("low", 0.0), ("high", 0.4 - depth)))
    scene.add(pi.Contact(high.section("bottom"), low.section("top"), name="between"))
    with pytest.raises(pi.InputError, match=f"between: its sides are {depth:g} m within each other at rest"):
        scene.build()
    scene = pi.Scene()
    low, high = (scene.add(kind(plate(1.0, 10, y, name))) for name, y in (("low", 0.0), ("high", -0.5)))
    scene.add(pi.Contact(high.section("bottom"), low.section("top")))
    scene.build()


THIN = pi.Material(E=2e6, nu=0.3, rho=1000.0, viscosity=3e-2)


@pytest.mark.parametrize("of_plate_first", [True, False])
def test_sections_of_a_rigid_plate_are_edges_of_a_body(of_plate_first):
    """A box that falls turned on another and slides there moves as the rigid body with the edges of the plate."""
    ways, start = [], {"origin": (-0.25, 0.21), "velocity": (0.5, -0.4), "spin": 0.2}
    for of_plate in (True, False):
        scene, mesh = pi.Scene(gravity=(0.0, -10.0)), pi.mesh.quads(0.6, 0.2, 6, 2)
        low = scene.add(box("low", (0.0, 0.0)))
        if of_plate:
            high = scene.add(pi.Rigid(pi.Plate(mesh, THIN, 0.01, name="high", **start)))
            side = high.section("bottom")
            assert len(side.each()) == 2 and side.depth == pytest.approx(0.1)
        else:
            high = scene.add(pi.RigidBody.from_mesh(mesh, THIN, 0.01, points={"a": (0.0, -0.1), "b": (0.6, -0.1)}, name="high", **start))
            side = high.edges("a", "b")
        sides = side, low.edges("c", "d")
        scene.add(pi.Contact(*sides[:: 1 if of_plate_first else -1], friction=0.3, name="hit"))
        scene.add(pi.Clamp(low.at("a"), name="held"))
        run = pi.solve(scene.build(), 0.08, pi.NonsmoothAlpha(h=1e-3))
        assert run.success and {one.name for one in run.events} == {"hit"}, run.message
        ways.append(run.position(high.at("center")))
        rows = run.model.rows["hit"]
        assert min(run.model.phi(t, q)[rows][::2].min() for t, q in zip(run.t, run.q)) > -1e-9
    assert np.ptp(ways[0][:, 0]) > 0.02 and np.abs(ways[0] - ways[1]).max() < 1e-9


def test_a_rigid_plate_falls_on_the_ground_by_events():
    """Its two corners touch; the section's mean alone would let it turn through the ground."""
    scene = pi.Scene(gravity=(0.0, -10.0))
    slab = scene.add(pi.Rigid(pi.Plate(pi.mesh.quads(0.6, 0.2, 6, 2), THIN, 0.01, origin=(0.0, 0.2), angle=0.1, name="slab")))
    scene.add(pi.Contact(slab.section("bottom"), pi.ground.at((0.0, 0.0)), friction=0.5, name="ground"))
    model = scene.build()
    assert len(model.row_laws) == 4
    for integrator in (pi.RadauIIA(rtol=1e-8), pi.NonsmoothAlpha(h=1e-3)):
        run = pi.solve(model, 1.0, integrator)
        assert run.success, run.message
        assert min(run.position(node)[:, 1].min() for node in slab.section("bottom").each()) > -1e-6
        assert run.reaction("ground")[-1, 1] == pytest.approx(-0.6 * 0.2 * 0.01 * 1000.0 * 10.0, rel=1e-6)
