"""Cases of the stress study with contact without stiffness and dry friction, against closed forms."""

import numpy as np

import polyida as pi
from nonsmooth.references import bounces, rest_of_bounces
from polyida.run.solve import solve
from stress.outcome import Check, Stop

G = 9.81
WAYS = ("events", "nonsmooth", "moreau")
STEP = 1e-3  # s


def method(name):
    """Radau IIA by events, or a method of time stepping."""
    return {"events": pi.RadauIIA(rtol=1e-7), "nonsmooth": pi.NonsmoothAlpha(h=STEP), "moreau": pi.MoreauJean(h=STEP)}[name]


def allowed(name, speed):
    """Error of a place: round-off and tolerance by events, some ways of one step by time stepping."""
    return 1e-5 if name == "events" else 4.0 * STEP * max(speed, 1.0)


def floor():
    """The x axis."""
    return pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))


def body(points, origin=(0.0, 0.0), mass=1.0, **more):
    """A rigid body with its centre "c" and other points."""
    return pi.RigidBody(mass=mass, inertia=0.1 * mass, points={"c": (0.0, 0.0)} | points, origin=origin, **more)


def gap_check(run, name):
    """The Check of penetration: none, but of the order of a step for Moreau-Jean."""
    lowest = min(float(run.model.phi(t, q)[row.row]) for t, q in zip(run.t, run.q) for row in run.model.row_laws if row.is_contact)
    return Check("penetration, m", max(-lowest, 0.0), 5 * STEP if name == "moreau" else 1e-9)


def many_contacts(count, name):
    """That many balls fall from different heights, e = 0.5: each height after 0.5 s is that of the closed form."""
    scene, heights = pi.Scene(gravity=(0.0, -G)), 0.1 + 0.4 * (np.arange(count) + 0.5) / count
    balls = [scene.add(body({}, (float(k), float(height)), name=f"ball {k}")) for k, height in enumerate(heights)]
    for k, ball in enumerate(balls):
        scene.add(pi.Contact(ball.at("c"), floor(), restitution=0.5, name=f"floor {k}"))
    run = solve(scene.build(), 0.5, method(name))
    at = np.array([run.position(ball.at("c"))[-1, 1] for ball in balls])
    right = [bounces(0.5, 0.5, height=height)[0] for height in heights]
    return run, [Check("height, m", float(np.abs(at - right).max()), allowed(name, 3.0)), gap_check(run, name)]


def redundant_contacts(feet, name):
    """A long body with that many feet slides with 1 m/s, mu = 0.3, to rest: way v^2 / 2 mu g, and the feet carry the weight together."""
    scene = pi.Scene(gravity=(0.0, -G))
    places = {f"foot {k}": (x, 0.0) for k, x in enumerate(np.linspace(-1.0, 1.0, feet) if feet > 1 else [0.0])}
    slider = scene.add(body(places, velocity=(1.0, 0.0), name="slider"))
    for foot in places:
        scene.add(pi.Contact(slider.at(foot), floor(), friction=0.3, name=foot))
    run = solve(scene.build(), 0.5, method(name))
    force = sum(run.reaction(foot)[-1] for foot in places)
    way = run.position(slider.at("c"))[-1, 0] - 1.0 / (2.0 * 0.3 * G)
    return run, [
        Check("way, m", float(abs(way)), allowed(name, 1.0)),
        Check("weight, of itself", float(abs(abs(force[1]) / G - 1.0)), 1e-6),
        Check("speed at the end, m/s", float(np.abs(run.v[-1]).max()), 1e-6),
        gap_check(run, name),
    ]


def two_feet_stick(feet, name):
    """Rows of friction that stick and depend on each other need time stepping; the run stops with that advice."""
    return (
        Stop(("events", "singular", "contact"), ("NonsmoothAlpha", "redundant", "singular"), only=False)
        if feet > 1 and name == "events"
        else None
    )


def friction(mu, name):
    """A body on an incline of 0.3 rad begins with 1 m/s: the way of the closed form, and it rests if mu > tan 0.3."""
    angle, t_end = 0.3, 0.5
    scene = pi.Scene(gravity=(G * np.sin(angle), -G * np.cos(angle)))
    block = scene.add(body({}, velocity=(1.0, 0.0), name="block"))
    scene.add(pi.Contact(block.at("c"), floor(), friction=mu, name="floor"))
    run = solve(scene.build(), t_end, method(name))
    pull = G * (np.sin(angle) - mu * np.cos(angle))
    t = t_end if pull >= 0.0 else min(t_end, -1.0 / pull)
    way = run.position(block.at("c"))[-1, 0] - (t + 0.5 * pull * t * t)
    rest = Check("speed at rest, m/s", float(np.abs(run.v[-1]).max()) if t < t_end else 0.0, 1e-9)
    return run, [Check("way, m", float(abs(way)), allowed(name, 1.0)), rest, gap_check(run, name)]


def restitution(e, name):
    """A ball falls 0.2 m and bounces for 1 s: its height is that of the closed form, and the energy never grows."""
    scene = pi.Scene(gravity=(0.0, -G))
    ball = scene.add(body({}, (0.0, 0.2), name="ball"))
    scene.add(pi.Contact(ball.at("c"), floor(), restitution=e, name="floor"))
    run = solve(scene.build(), 1.0, method(name))
    right = bounces(1.0, e, height=0.2)[0]
    grown = float((run.energy.total - run.energy.total[0]).max()) / (G * 0.2)
    return run, [
        Check("height, m", float(abs(run.position(ball.at("c"))[-1, 1] - right)), 4.0 * allowed(name, 2.0)),
        Check("energy gained", max(grown, 0.0), 1e-6 if name != "moreau" else 0.05),
        gap_check(run, name),
    ]


def bounces_that_end(e, name):
    """A ball of restitution e rests behind the end of its bounces, and the floor carries its weight."""
    scene = pi.Scene(gravity=(0.0, -G))
    ball = scene.add(body({}, (0.0, 0.1), name="ball"))
    scene.add(pi.Contact(ball.at("c"), floor(), restitution=e, name="floor"))
    run = solve(scene.build(), rest_of_bounces(e, height=0.1) + 0.2, method(name))
    return run, [
        Check("height at rest, m", float(abs(run.position(ball.at("c"))[-1, 1])), 1e-9 if name != "moreau" else 5 * STEP),
        Check("speed at rest, m/s", float(np.abs(run.v[-1]).max()), 1e-9),
        Check("weight, of itself", float(abs(abs(run.reaction("floor")[-1, 1]) / G - 1.0)), 1e-6),
        gap_check(run, name),
    ]


def masses(ratio, name):
    """A ball of 1 kg hits one of that mass at rest, e = 1: velocities of the closed form."""
    scene = pi.Scene()
    one = scene.add(body({}, velocity=(1.0, 0.0), name="one"))
    other = scene.add(body({}, (0.1, 0.0), mass=ratio, name="other"))
    scene.add(pi.Contact(one.at("c"), other.at("c", direction=(0.0, 1.0)), restitution=1.0, name="hit"))
    run = solve(scene.build(), 0.2, method(name))
    ends = [run.v[-1, k * (run.v.shape[1] // 2)] for k in range(2)]
    right = (1.0 - ratio) / (1.0 + ratio), 2.0 / (1.0 + ratio)
    return run, [Check("velocity, m/s", float(np.abs(np.subtract(ends, right)).max()), 1e-6), gap_check(run, name)]


def stacked(ratio, name):
    """A body of that mass rests on one of 1 kg, which rests on the floor: the floor carries both, and nothing moves."""
    scene = pi.Scene(gravity=(0.0, -G))
    low = scene.add(body({}, name="low"))
    high = scene.add(body({}, mass=ratio, name="high"))
    scene.add(pi.Contact(low.at("c"), floor(), name="floor"))
    scene.add(pi.Contact(high.at("c"), low.at("c", direction=(1.0, 0.0)), name="between"))
    run = solve(scene.build(), 0.1, method(name))
    carried = abs(run.reaction("floor")[-1, 1]) / (G * (1.0 + ratio)) - 1.0
    return run, [Check("force of the floor", float(abs(carried)), 1e-6), Check("moved, m", float(np.abs(run.q[-1]).max()), 1e-9)]
