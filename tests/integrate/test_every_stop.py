"""A run that was stopped at any of its steps and goes on is the run that was never stopped, bit by bit."""

import numpy as np
import pytest

import polyida as pi

FRAMES = ("t", "q", "v", "a", "lam")
T_END = 0.06
PULL = pi.profile.linear(0.0, 1.0, 0.02, begin=0.02)
RADAU = {
    "three stages": pi.RadauIIA(h=5e-3),
    "two stages": pi.RadauIIA(h=5e-3, stages=2),
    "index3": pi.RadauIIA(h=5e-3, form="index3"),
    "kkt": pi.RadauIIA(h=5e-3, linear="kkt"),
    "three stages, rtol": pi.RadauIIA(rtol=1e-5),
    "two stages, rtol": pi.RadauIIA(rtol=1e-5, stages=2),
    "index3, two stages, rtol": pi.RadauIIA(rtol=1e-4, stages=2, form="index3"),
}
ALPHA = {
    "alpha": pi.GeneralizedAlpha(h=5e-3),
    "stabilised": pi.GeneralizedAlpha(h=5e-3, form="stabilised"),
    "phi from positions": pi.GeneralizedAlpha(h=5e-3, incremental_phi=False),
}


def driven():
    """Two rigid bars: one is turned far within a part of the run, one by a sine and pulled by a spring and a load that begins late."""
    scene = pi.Scene()
    turns = {"spun": pi.profile.linear(0.0, 4.0, 0.01, begin=0.02), "swung": pi.profile.sine(1.0, 0.3)}
    for name, angle in turns.items():
        bar = scene.add(pi.RigidBody(1.0, 0.1, {"left": (-0.5, 0.0), "right": (0.5, 0.0)}, origin=(0.5, 0.0), name=name))
        scene.add(pi.Revolute(pi.ground, bar.at("left"), name=f"pin of {name}"))
        scene.add(pi.AngleMotor(pi.ground, bar.at("left"), angle, name=f"motor of {name}"))
    scene.add(pi.SpringDamper(pi.ground.at((0.0, 1.0)), bar.at("right"), stiffness=50.0, damping=1.0, name="spring"))
    scene.add(pi.PointLoad(bar.at("right"), (0.0, 5.0), PULL, name="pull"))
    return scene.build(), {}


def plate():
    """A bar with viscosity on a pin, at rest until it is pulled."""
    scene, rubber = pi.Scene(gravity=(0.0, 0.0)), pi.Material(E=5e6, nu=0.3, rho=1100.0, viscosity=1e-3)
    bar = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=4, seed=1), rubber, thickness=0.01, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.section("left"), name="pin"))
    scene.add(pi.PointLoad(bar.section("right"), (0.0, 5.0), PULL, name="pull"))
    return scene.build(), {}


class Bead(pi.Model):
    """A bead on a circle, its mass a function of its place, and a weight that falls from 9.81 N to 4 N within a kink at 0.03 s."""

    n, m = 2, 1

    def mass(self, q):
        return np.diag([1.0 + q[0] ** 2, 1.0 + q[0] ** 2])

    def force(self, t, q, v):
        turning = np.array([q[0] * (v[0] ** 2 - v[1] ** 2), 2.0 * q[0] * v[0] * v[1]])  # of M' in Lagrange's equations
        return turning + (0.0, 9.81 if t < 0.03 else 4.0)

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2.0 * q[None]

    def kinks(self, t0, t1):
        return (0.03,) if t0 <= 0.03 <= t1 else ()


def bead():
    return Bead(), {"q0": [0.8, 0.6]}


CASES = [
    (driven, name)
    for name in RADAU | ALPHA
    if name not in ("kkt", "two stages", "three stages, rtol", "index3", "index3, two stages, rtol")
]
CASES += [(plate, name) for name in ("two stages, rtol", "index3, two stages, rtol", "alpha")]
CASES += [(bead, "kkt"), (bead, "three stages, rtol"), (bead, "alpha")]


@pytest.mark.parametrize("scene, name", CASES, ids=lambda value: getattr(value, "__name__", value))
def test_stopped_at_every_step_bit_by_bit(scene, name):
    """Each part of the run goes one step on from the state of the part before: what one stop loses, no later part has again."""
    (model, start), integrator = scene(), (RADAU | ALPHA)[name]
    whole = pi.solve(model, T_END, integrator, **start)
    assert whole.success and len(whole) > 4

    def progress(now):
        if now > begin:
            raise KeyboardInterrupt

    begin = 0.0
    for number in range(len(whole) - 1):
        part = pi.solve(model, T_END, integrator, progress=progress, **start)
        assert len(part) == 2
        for key in FRAMES:
            assert np.array_equal(getattr(part, key), getattr(whole, key)[number : number + 2]), (number, key)
        begin, start = part.t[-1], {"state": part.state}


@pytest.mark.parametrize("name", ["three stages", "three stages, rtol"])
def test_a_file_that_ends_at_any_flush_goes_on_bit_by_bit(name, tmp_path):
    """What is left of a run that was killed: the frames up to a flush, and what the sensors gave."""
    (model, _), sensors, path = driven(), {"tip": lambda t, q, v: q[-1] + v[-1]}, tmp_path / "run.h5"
    whole = pi.solve(model, T_END, RADAU[name], sensors=sensors)
    for number in (1, len(whole) // 2, len(whole) - 2):

        def progress(t, last=whole.t[number]):
            if t == last:
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            pi.solve(model, T_END, RADAU[name], sensors=sensors, out=path, overwrite=True, flush_every=3, progress=progress)
        rest = pi.resume(path, sensors=sensors)
        assert rest.counts == whole.counts and np.array_equal(rest.sensors["tip"], whole.sensors["tip"])
        assert all(np.array_equal(getattr(rest, key), getattr(whole, key)) for key in FRAMES)
