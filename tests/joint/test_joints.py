"""Every kind of joint: its formula, derivatives, virtual work, and how it moves with the scene."""

from functools import cache

import numpy as np
import pytest

import polyida as pi
from polyida.model.differences import along

J = np.array([[0.0, 1.0], [-1.0, 0.0]])
WAVE = pi.profile.sine(0.7, 0.4, 0.2)
T = 0.3


@pytest.fixture(params=["full", "reduced", "rigid"])
def level(request):
    """What plates are made into."""
    return request.param


@pytest.fixture(scope="module")
def made(scenes):
    """Function (kind, level) -> two plates with such a joint, driven by a profile whose derivatives are all at work."""
    return cache(lambda kind, level: scenes.jointed(kind, WAVE, level=level, cells=8).build())


@pytest.fixture
def model(made, kind, level):
    return made(kind, level)


@pytest.fixture
def draw(model):
    """Random vectors of the model's size."""
    random = np.random.default_rng(3)
    return lambda size=None: 0.3 * random.standard_normal(model.n if size is None else size)


def side(model, attachment, q, weights):
    """Weighted sum of an attachment's nodal positions, from its own data."""
    plate = attachment.body if attachment.body.is_full else attachment.body.plate
    start = next(body.nodes.start for body in model.drawn if body.plate is plate)
    return weights @ (model.drawn_points + model.nodal(q))[attachment.nodes + start]


def expected(model, name, t, q, rotation):
    """phi of a joint by the formula of its docstring."""
    joint = model.parts[name]
    if isinstance(joint, pi.AngleMotor):
        a, b = (None if s is pi.ground else side(model, s, q, s.turn_weights) for s in (joint.a, joint.b))
        rest_a, rest_b = (other.direction if s is pi.ground else s.direction for s, other in ((joint.a, joint.b), (joint.b, joint.a)))
        a, b = (rest_a if a is None else a), (rest_b if b is None else b)
        start = np.arctan2(rest_a[0] * rest_b[1] - rest_a[1] * rest_b[0], rest_a @ rest_b)
        return [(rotation(joint.angle(t) + start) @ a) @ J @ b]
    if isinstance(joint, pi.Clamp) and pi.ground in (joint.a, joint.b) and model.bodies:
        held, sign = (joint.a, 1.0) if joint.b is pi.ground else (joint.b, -1.0)
        start = next(body.nodes.start for body in model.bodies if body.plate is held.body)
        return sign * q.reshape(-1, 2)[held.nodes + start].ravel()
    sides = (joint.a, joint.b), (joint.b, joint.a)
    points = [side(model, s, q, s.weights) if s.body else other.point if s is pi.ground else s.point for s, other in sides]
    result = points[0] - points[1]
    if isinstance(joint, (pi.Clamp, pi.Weld, pi.Prismatic, pi.Slot)):
        rest = [other.direction if s is pi.ground else s.direction for s, other in ((joint.a, joint.b), (joint.b, joint.a))]
        a, b = (r if s.body is None else side(model, s, q, s.turn_weights) for s, r in zip((joint.a, joint.b), rest))
        back = rotation(np.arctan2(rest[1][0] * rest[0][1] - rest[1][1] * rest[0][0], rest[1] @ rest[0]))
        if isinstance(joint, pi.Slot):
            return a @ J @ -result
        across, turned = [a @ J @ -result], [(back.T @ a) @ J @ b]
        alike = turned if isinstance(joint, pi.Prismatic) or joint.a.turns_only or joint.b.turns_only else a - back @ b
        result = np.concatenate([across if isinstance(joint, pi.Prismatic) else result, alike])
    if isinstance(joint, pi.Distance):
        return (result @ result - joint.length**2) / (2 * joint.length)
    return points[1] - [joint.x(t), joint.y(t)] if isinstance(joint, pi.PrescribedPosition) else result


def test_formula(model, scenes, draw):
    q = draw()
    found = model.phi(T, q)[model.rows["joint"]]
    assert np.allclose(found, np.ravel(expected(model, "joint", T, q, scenes.rotation)), atol=1e-13)


def test_rest_is_on_the_constraints(scenes, kind, level):
    model = scenes.jointed(kind, level=level).build()
    assert np.abs(model.phi(0.0, np.zeros(model.n))).max() < 1e-14


def test_derivatives(model):
    found = pi.check_derivatives(model, T)
    assert max(found.values()) < 1e-7, found


def test_rates_along_a_motion(model, draw):
    q, v, a = draw(), draw(), draw()
    place = lambda s: q + s * v + s * s / 2 * a  # noqa: E731
    first = along(lambda s: model.phi(T + s, place(s)))
    rate = lambda s: model.phi_q(T + s, place(s)) @ (v + s * a) + model.phi_t(T + s, place(s))  # noqa: E731
    assert np.allclose(rate(0.0), first, atol=1e-9)
    assert np.allclose(model.phi_q(T, q) @ a + model.phi_bias(T, q, v), along(rate), atol=1e-8)


def test_virtual_work(model, draw):
    q, v, lam = draw(), draw(), draw(model.m)
    still, none = np.zeros(model.n), np.zeros(model.m)
    force = model.residual(T, q, v, still, lam) - model.residual(T, q, v, still, none)
    power, size = along(lambda s: model.phi(T, q + s * v)) @ lam, np.abs(model.residual(T, q, v, still, lam)).max()
    assert force @ v == pytest.approx(power, rel=1e-7, abs=1e-14 * size * len(v))
    assert np.allclose(force, model.phi_q(T, q).T @ lam, atol=1e-9 * size)


@pytest.mark.parametrize("kind", ["revolute", "clamp between", "motor between", "prismatic", "slot", "weld"], indirect=True)
def test_joints_between_bodies_turn_with_the_whole_scene(model, scenes, draw):
    q = draw()
    rows = model.rows["joint"]
    before, after = (model.phi(T, x)[rows] for x in (q, scenes.turned(model, q, 2.1, (0.4, -3.0))))
    if model.labels[rows.start].endswith("x"):
        vectors = len(before) // 2 * 2
        before[:vectors] = (before[:vectors].reshape(-1, 2) @ scenes.rotation(2.1).T).ravel()
    assert np.allclose(after, before, atol=1e-13)


def require_reaction(model, q, lam):
    """The reaction of "joint" is force and moment about its point of `-phi_q^T lam` on the body of b."""
    joint, rows = model.joints["joint"], model.rows["joint"]
    place = model.places[id(joint.b.body)]
    pull = -(lam[rows] @ model.phi_q(0.0, q)[rows]).reshape(-1, 2)[place.pairs] @ (1.0, 1j)
    shift = getattr(place, "translation", np.ones(len(pull)))  # of the coordinates, where the whole body moves by one
    z = (model.reference + q.reshape(-1, 2))[place.pairs] @ (1.0, 1j)
    force, arms = shift.conj() @ pull, z - shift * (model.position("joint", q[None])[0] @ (1.0, 1j))
    told = model.reactions("joint", q[None], lam[None, rows])[0]
    assert abs(told[:2] @ (1.0, 1j) - force) < 1e-12 and abs(force) > 1e-3
    assert (arms.conj() @ pull).imag == pytest.approx(told[2] if len(told) > 2 else 0.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["prismatic", "slot", "distance", "weld", "path"], indirect=True)
def test_a_reaction_is_what_the_multipliers_do_to_b(model, scenes, draw):
    """Wherever the scene is turned to."""
    require_reaction(model, scenes.turned(model, np.zeros(model.n), 0.8), draw(model.m))


@pytest.mark.parametrize("turns", [0.25, 1.5, -3.2, 100.0])
def test_motor_holds_at_any_number_of_turns(scenes, turns):
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=lambda t: 2 * np.pi * turns * t, name="drive"))
    model = scene.build()
    q = scenes.turned(model, np.zeros(model.n), 2 * np.pi * turns)
    assert np.abs(model.phi(1.0, q)).max() < 1e-12
    assert model.rejection_reason(1.0, q) is None
    assert "half-turn" in model.rejection_reason(1.0, scenes.turned(model, np.zeros(model.n), 2 * np.pi * turns + np.pi))


def test_hole_rims(scenes):
    link = scenes.plate("link", mesh=pi.mesh.polygonize(pi.mesh.Link(1.0, 0.2, 0.05), cells=120, seed=2), angle=0.7)
    for hole, place in ((0, (0.0, 0.0)), (1, (1.0, 0.0))):
        rim = link.rim(hole)
        assert np.allclose(rim.point, scenes.rotation(0.7) @ place, atol=1e-15)
        assert rim.turn_weights.sum() == pytest.approx(0.0, abs=1e-13)
        assert np.linalg.norm(rim.direction) == pytest.approx(1.0)
        assert rim.length == pytest.approx(2 * np.pi * 0.05, rel=0.05)
        assert np.allclose(pi.RigidBody.from_mesh(link.mesh, link.material, 0.01).at(f"hole {hole}").point, place, atol=1e-15)


def test_directions_are_integrals_of_the_linear_field_along_the_edges(scenes):
    """By three points of Gauss for each edge, of any field, on edges of unequal lengths; sums over nodes differ in the second digit."""
    place, weight = np.polynomial.legendre.leggauss(3)
    plate = scenes.plate("plate", mesh=pi.mesh.polygonize(pi.mesh.Rectangle(1.0, 0.4), cells=30, seed=4), angle=0.7)
    for name in ("left", "top"):
        side = plate.section(name)
        s = (plate.placed.points[side.nodes] - side.point) @ side.direction
        u, order = np.random.default_rng(5).standard_normal(len(s)), np.argsort(s)
        s, ends = s[order], u[order]
        at = 0.5 * (s[1:] + s[:-1])[:, None] + 0.5 * np.diff(s)[:, None] * place
        ds, field = 0.5 * np.diff(s)[:, None] * weight, np.interp(at, s, ends)
        assert np.ptp(np.diff(s)) > 1e-3 and side.turn_weights @ u == pytest.approx((ds * at * field).sum() / (ds * at**2).sum(), rel=1e-12)


def test_a_loop_of_links_that_is_drawn_exactly_closes(scenes):
    """The pin of each link is where its hole is, so a rhombus needs no `assemble`; a constant traction on a rim pulls at all of it evenly."""
    mesh, scene = pi.mesh.polygonize(pi.mesh.Link(1.0, 0.2, 0.05), cells=60, seed=2), pi.Scene()
    corners = np.cumsum([[0, 0], [1, 0], [np.cos(1.2), np.sin(1.2)], [-1, 0]], axis=0)
    angles = [0.0, 1.2, np.pi, np.pi + 1.2]
    links = [scene.add(scenes.plate(f"link {k}", mesh=mesh, origin=at, angle=angle)) for k, (at, angle) in enumerate(zip(corners, angles))]
    for link, other in zip(links, links[1:] + links[:1]):
        scene.add(pi.Revolute(link.rim(1), other.rim(0)))
    scene.add(pi.EdgeTraction(links[0].rim(0), (0.0, 1e3), name="pull"))
    model = scene.build()
    assert np.abs(model.phi(0.0, np.zeros(model.n))).max() < 1e-14
    force = scene.parts["pull"].nodal()
    assert np.allclose(force[:, 1], 1e3 * scenes.THICKNESS * mesh.section("hole 0").lengths, rtol=1e-14)


def test_a_formula_of_two_turned_vectors_and_sums(scenes):
    """Both sides turned by profiles, numbers and sums: against the same written out."""

    class Odd(pi.Joint):
        def rows(self):
            p, q = pi.profile.sine(0.3, 0.7), pi.profile.polynomial([0.0, 0.2, -0.1])
            apart = self.b.x - self.a.x
            return [2.0 * pi.dot(self.a.d.turned(p), self.b.d.turned(q)) - pi.dot(self.a.d, self.b.d) * 2.0 + pi.dot(apart, apart) / 3.0]

    scene, upper, lower = scenes.pair()
    scene.add(pi.Revolute(pi.ground, upper.section("left")))
    scene.add(Odd(upper.section("right"), lower.section("left"), name="odd"))
    model, random = scene.build(), np.random.default_rng(0)
    q = 0.1 * random.standard_normal(model.n)
    a, b, t = upper.section("right"), lower.section("left"), 0.4
    x_a, x_b, d_a, d_b = (side(model, s, q, w) for s, w in ((a, a.weights), (b, b.weights), (a, a.turn_weights), (b, b.turn_weights)))
    turn = scenes.rotation(0.3 * np.sin(1.4 * np.pi * t)), scenes.rotation(0.2 * t - 0.1 * t * t)
    exact = 2.0 * (turn[0] @ d_a) @ (turn[1] @ d_b) - 2.0 * d_a @ d_b + (x_b - x_a) @ (x_b - x_a) / 3.0
    assert model.phi(t, q)[model.rows["odd"]] == pytest.approx([exact], abs=1e-13)
    assert max(pi.check_derivatives(model, t, q=q).values()) < 1e-6


SQUARED = r"at most two factors, so use pi.dot and pi.cross, and square the condition of a length: `pi.dot\(w, w\) - r\*\*2`"
MISTAKES = {
    "a number": (lambda a, b: [a.x - b.x, 1.0], "entry 2 of 2 is 1.0; the list needs a vector there, .* or a row"),
    "text": (lambda a, b: ["x"], "entry 1 of 1 is the text 'x'"),
    "None": (lambda a, b: None, "must give a list of rows, not None"),
    "a row, no list": (lambda a, b: pi.dot(a.d, b.d), "must give a list of rows, not a row of RigidBody 'wheel' rim"),
    "a list in a list": (lambda a, b: [[a.x - b.x]], "entry 1 of 1 is a list of 1"),
    "an array": (lambda a, b: [np.zeros(2)], r"entry 1 of 1 is an array of shape \(2,\)"),
    "no row": (lambda a, b: [], "at least one"),
    "nan": (lambda a, b: [pi.dot(a.d, b.x) * np.nan], "multiplied by nan"),
    "too large": (lambda a, b: [pi.dot(a.d, b.d) * 1e300 * 1e300], "row 1 of 1 is not finite at rest"),
    "three factors": (lambda a, b: [pi.dot(pi.dot(a.d, b.d) * a.x, b.x)], "at most two factors"),
    "a row in a product": (lambda a, b: [pi.dot(pi.dot(a.d, b.d), b.x)], "not a row of .*at most two factors"),
    "two rows": (lambda a, b: [pi.dot(a.d, b.d) * pi.dot(a.d, b.d)], "multiplied by a row of .*at most two factors"),
    "two vectors": (lambda a, b: [a.x * b.x], "pi.dot and pi.cross multiply two vectors"),
    "a vector in a sum": (lambda a, b: [pi.dot(a.d, b.d) + b.x], "is added to a vector of RigidBody 'wheel' rim"),
    "a number less a vector": (lambda a, b: [2.0 - b.x], "needs a vector here.*not 2.0"),
    "an array times a vector": (lambda a, b: [np.ones(2) * b.x], "multiplied by an array"),
    "a division": (lambda a, b: [pi.dot(a.d, b.d) / 0.0], "divided by 0.0"),
    "a power": (lambda a, b: [pi.dot(a.d, b.d) ** 2], "raised TypeError.*in `return self.formula.*at most two factors"),
    "a root": (lambda a, b: [np.sqrt(pi.dot(b.x, b.x)) - 1.0], SQUARED),
    "a root as a power": (lambda a, b: [pi.dot(b.x, b.x) ** 0.5 - 1.0], SQUARED),
    "a norm": (lambda a, b: [np.linalg.norm(b.x) - 1.0], SQUARED),
    "a matrix product": (lambda a, b: [b.x @ b.x - 1.0], SQUARED),
    "an index": (lambda a, b: [b.x[0] - 1.0], SQUARED),
    "a law of a vector": (lambda a, b: [(b.x - a.x).opens(0.5)], "`opens` is of rows, which pi.dot and pi.cross make of vectors"),
    "another error": (lambda a, b: [len(3)], r"has no len\(\)$"),
    "no label": (lambda a, b: [pi.dot(a.d, b.d).named(3)], "named: label 3"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_in_rows_is_told_in_words(kind):
    formula, words = MISTAKES[kind]

    class Mistaken(pi.Joint):
        def rows(self):
            return self.formula(self.a, self.b)

    Mistaken.formula = staticmethod(formula)
    scene = pi.Scene()
    wheel = scene.add(pi.RigidBody(1.0, 1.0, {"rim": (0.5, 0.0)}, name="wheel"))
    scene.add(Mistaken(pi.ground.at((0.5, 0.0), direction=(1.0, 0.0)), wheel.at("rim"), name="rail"))
    with pytest.raises(pi.InputError, match=rf"^rail: rows\(\) of Mistaken.*{words}") as caught:
        scene.build()
    assert not any(word in str(caught.value) for word in ("Row(", "Vector(", "Piece(", "Product("))


class WithInit(pi.Joint):
    def __init__(self, a, b, length):
        self.length = length


class WithoutDecorator(pi.Joint):
    length: float = 1.0


class ForceWithInit(pi.ForceElement):
    def __init__(self, a, b, stiffness):
        self.a, self.b = a, b


class ForceWithoutDecorator(pi.ForceElement):
    a: object
    b: object


class BodyWithInit(pi.Body):
    def __init__(self, *lengths):
        self.lengths = lengths


@pytest.mark.parametrize("kind", [WithInit, WithoutDecorator, ForceWithInit, ForceWithoutDecorator, BodyWithInit])
def test_a_part_with_fields_that_is_no_dataclass_is_refused(kind):
    with pytest.raises(pi.InputError, match=rf"^{kind.__name__}: its fields need @dataclass"):
        kind(pi.ground, pi.RigidBody(1.0, 1.0, {"rim": (0.5, 0.0)}).at("rim"), 2.0)


@pytest.mark.parametrize(("length", "told"), [(None, "the points coincide: their distance is [4-8].*e-16 m"), (1e-15, "length is 1e-15 m")])
def test_a_rod_whose_length_is_round_off_is_refused(length, told):
    bar = pi.RigidBody.bar(1.0, 1.0, name="bar")
    assert np.abs(bar.at("left").point).max() < 1e-16  # round-off, on some processors zero
    with pytest.raises(pi.InputError, match=f"^Distance 'rod': {told}, round-off beside coordinates of 0.5 m"):
        pi.Distance(pi.ground.at((6e-16, 0.0)), bar.at("left"), length=length, name="rod")
