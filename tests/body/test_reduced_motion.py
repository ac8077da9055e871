"""Reduced and rigid plates that move: against a floating frame of reference, far away and turned, what is conserved, in all integrators."""

import numpy as np
import pytest

import polyida as pi

G = 9.81
RUBBER = pi.Material(E=50e6, nu=0.3, rho=1100.0)


def mesh():
    return pi.mesh.rectangle(1.0, 0.1, cells=16, seed=2)


class FloatingFrame(pi.Model):
    """A hinged plate in `x = R + e^{i theta} (s (X - X_S) + sum eta_k f_k)`, p = (R, theta, s, eta): the span of a Reduced plate in the
    coordinates of a floating frame of reference, with M(p) and gyroscopic terms; energy and mass are the full plate's.
    """

    def __init__(self, few, full, hinge, about):
        self.fields, self.full, self.n, self.m = few.reduced_bodies[0].body.shapes(), full, few.n, 2
        pairs, weights = full.pairs_and_weights(hinge, "point")
        self.hinge = weights @ self.fields[pairs]
        self.rest, self.about = few.reduced_bodies[0].rest, about
        self.M = full.mass()

    def split(self, p):
        """(e^{i theta}, [s, eta])."""
        return np.exp(1j * p[2]), np.concatenate([[p[3]], p[4:].reshape(-1, 2) @ (1, 1j)])

    def place(self, p):
        """The coordinates (c, z, zeta) of the complex plane."""
        turn, shape = self.split(p)
        return np.concatenate([[complex(*p[:2])], turn * shape])

    def slopes(self, p):
        """d(c, z, zeta)/dp, (pairs, n), complex."""
        turn, shape = self.split(p)
        T = np.zeros((len(shape) + 1, self.n), complex)
        T[0, :2] = 1, 1j
        T[1:, 2] = 1j * turn * shape
        T[1, 3] = turn
        for k in range(2, len(T)):
            T[k, 2 * k : 2 * k + 2] = turn, 1j * turn
        return T

    def nodal(self, z):
        """Displacements or velocities of all nodes, flat, of complex columns."""
        moved = self.fields @ z
        return np.stack([moved.real, moved.imag], axis=1).reshape(2 * len(moved), *moved.shape[1:])

    def mass(self, p):
        T = self.nodal(self.slopes(p))
        return T.T @ (self.M @ T)

    def force(self, t, p, v):
        (turn, shape), rate = self.split(p), np.concatenate([[v[3]], v[4:].reshape(-1, 2) @ (1, 1j)])
        coriolis = np.concatenate([[0.0], turn * (2j * v[2] * rate - v[2] ** 2 * shape)])
        still = np.zeros(self.full.n)
        pull = self.M @ self.nodal(coriolis) + self.full.force(t, self.nodal(self.place(p) - self.rest), still)
        return self.nodal(self.slopes(p)).T @ pull

    def phi(self, t, p):
        x = self.hinge @ self.place(p)
        return np.array([x.real, x.imag]) - self.about

    def phi_q(self, t, p):
        row = self.hinge @ self.slopes(p)
        return np.array([row.real, row.imag])


def hinged(body, origin=(0.0, 0.0), angle=0.0, gravity=(0.0, -G)):
    """(scene, body) of a plate on a hinge with a mass on its other end."""
    scene = pi.Scene(gravity=gravity)
    plate = scene.add(body(pi.Plate(mesh(), RUBBER, 0.01, name="plate", origin=origin, angle=angle)))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hinge"))
    return scene, plate


def test_a_floating_frame_of_reference_gives_the_same_motion():
    """The same span in coordinates with M(p), gyroscopic forces and a frame's angle, its own formulas and the full plate's forces."""
    scene, plate = hinged(lambda plate: pi.Reduced(plate, modes=2))
    few, method, times = scene.build(), pi.RadauIIA(rtol=1e-9), np.linspace(0.0, 0.3, 7)
    whole = hinged(lambda plate: plate)
    frame = FloatingFrame(few, whole[0].build(), whole[1].section("left"), plate.section("left").point)
    start = np.zeros(frame.n)
    start[:2], start[3] = [frame.rest[0].real, frame.rest[0].imag], frame.rest[1].real
    other, run = pi.solve(frame, 0.3, method, q0=start, output=times), pi.solve(few, 0.3, method, output=times)
    assert run.success and other.success, other.message
    found = np.array([frame.place(p) for p in other.q])
    known = (few.reference + run.q.reshape(len(times), -1, 2)) @ (1, 1j)
    assert np.abs(found - known).max() < 1e-7 < 1e-3 * np.abs(known[-1] - known[0]).max()
    assert np.allclose(other.lam[-1], run.lam[-1], atol=1e-2) or np.allclose(other.lam[-1], -run.lam[-1], atol=1e-2)


@pytest.mark.parametrize("level", ["rigid", "reduced"])
def test_the_same_motion_far_away_and_turned(level):
    body = pi.Rigid if level == "rigid" else lambda plate: pi.Reduced(plate, modes=4)
    angle, place = 2.3, np.array([2e3, -1e3])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    paths = []
    for pose in ({}, {"origin": place, "angle": angle, "gravity": turn @ (0.0, -G)}):
        scene, plate = hinged(body, **pose)
        run = pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=1e-3))
        assert run.success, run.message
        paths.append(run.position(plate.section("right")))
    assert np.abs((paths[1] - place) @ turn - paths[0]).max() < 1e-9


def spinning(body):
    """(model, v0) of two plates joined in flight, turning fast and shaken, without gravity."""
    scene = pi.Scene()
    a, b = (scene.add(body(pi.Plate(mesh(), RUBBER, 0.01, origin=(k, 0.0), name=f"plate {k:g}"))) for k in (0.0, 1.0))
    scene.add(pi.Revolute(a.section("right"), b.section("left"), name="elbow"))
    model, random = scene.build(), np.random.default_rng(3)
    z = model.reference @ (1, 1j)
    v = 12.0 * 1j * z + 0.3 * (random.standard_normal(len(z)) + 1j * random.standard_normal(len(z)))
    v[[placed.pairs.start for placed in model.reduced_bodies]] += 1.0 - 0.5j
    v = np.stack([v.real, v.imag], axis=1).ravel()
    return model, model.mass_system(0.0, np.zeros(model.n)).solve(-model.mass() @ v, np.zeros(model.m))[0]


@pytest.mark.filterwarnings("ignore::polyida.errors.ReductionWarning")
@pytest.mark.parametrize("level", ["rigid", "reduced"])
def test_energy_and_momenta_over_many_turns(level):
    model, v0 = spinning(pi.Rigid if level == "rigid" else lambda plate: pi.Reduced(plate, modes=4))
    run = pi.solve(model, 4.0, pi.EnergyMomentum(h=2e-3, tolerance=1e-14), v0=v0)
    assert run.success, run.message
    z = (model.reference + run.q.reshape(len(run), -1, 2))[:, 1] @ (1, 1j)
    assert abs(np.unwrap(np.angle(z))[-1]) > 6 * np.pi
    assert np.ptp(run.energy.total) < 1e-9 * run.energy.total[0]
    assert np.ptp(run.momentum, axis=0).max() < 1e-10 * np.abs(run.momentum).max()
    assert np.ptp(run.angular_momentum) < 1e-9 * np.abs(run.angular_momentum).max()


def test_viscosity_takes_energy_from_vibrations_alone():
    """A free turning plate that was bent comes to rest in its frame: what is left turns as rigid, with the angular momentum of the start."""
    material = pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=2e-3)
    scene = pi.Scene()
    scene.add(pi.Reduced(pi.Plate(mesh(), material, 0.01), modes=3))
    model = scene.build()
    z = model.reference @ (1, 1j)
    v = 3.0 * 1j * z + np.array([0.0, 0.0, 0.3, -0.2, 0.1])
    v[0] = 0.0
    run = pi.solve(model, 1.0, pi.EnergyMomentum(h=1e-3), v0=np.stack([v.real, v.imag], axis=1).ravel())
    assert np.ptp(run.angular_momentum) < 1e-9 * np.abs(run.angular_momentum).max()
    total = run.energy.total
    assert (np.diff(total) < 1e-6 * total[0]).all() and total[-1] < 0.9 * total[0]
    spin = np.diff(np.unwrap(np.angle(((model.reference + run.q.reshape(len(run), -1, 2))[:, 1]) @ (1, 1j)))) / np.diff(run.t)
    assert np.ptp(spin[-100:]) < 1e-3 * abs(spin[-1])
    assert total[-1] - run.energy.strain[-1] == pytest.approx(run.angular_momentum[0] * spin[-1] / 2, rel=1e-3)
