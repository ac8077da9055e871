"""States, controllers and rolling in one script: runs unchanged, from any folder, in every integrator that takes them."""

from dataclasses import dataclass

import numpy as np

import polyida as pi


@dataclass(frozen=True, eq=False)
class Lag(pi.ForceElement):
    """Horizontal force `k s` at a point, N; its state follows a demand: `T s' = demand(t) - s`."""

    at: object
    demand: object
    k: float
    T: float
    name: str | None = None
    states = ("s",)

    def sizes(self):
        return [1.0]

    def sides(self):
        return (self.at,)

    def rates(self, t, x, v, s):
        return [(self.demand(t) - s[0]) / self.T]

    def forces(self, t, x, v, s):
        return np.array([[self.k * s[0], 0.0]])


@dataclass(frozen=True, eq=False)
class SampledPD(pi.Controller):
    """Force at a point along y, N, held between samples: `u = -kp y - kd y'`."""

    at: object
    kp: float
    kd: float
    period: float = 0.01
    name: str | None = None

    def sides(self):
        return (self.at,)

    def sample(self, t, x, v, s, u):
        return np.array([-self.kp * x[0, 1] - self.kd * v[0, 1]])

    def forces(self, t, x, v, s, u):
        return np.array([[0.0, u[0]]])


# 1. a cart on a rail, driven through a lag; its flexible, viscoelastic mast is held by a sampled controller
scene = pi.Scene(gravity=(0.0, 0.0))
cart = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(0.0, 0.0), name="cart"))
rubber = pi.Material(E=20e6, nu=0.3, rho=1100.0, prony=[(0.3, 0.02)])
mast = scene.add(pi.Plate(pi.mesh.rectangle(0.5, 0.03, cells=40, seed=1), rubber, 0.01, name="mast"))
scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), cart.at("c"), name="rail"))
scene.add(pi.Weld(cart.at("c"), mast.section("left"), name="foot"))
scene.add(pi.PointMass(mast.section("right"), 0.05, name="top"))
scene.add(Lag(cart.at("c"), pi.profile.linear(0.0, 1.0, 0.1), 2.0, 0.05, name="drive"))
scene.add(SampledPD(mast.section("right"), 20.0, 0.5, name="hold"))
model = scene.build()
integrators = {
    "alpha": pi.GeneralizedAlpha(h=5e-4),
    "Radau": pi.RadauIIA(rtol=1e-7),
    "IDA": pi.IDA(rtol=1e-6),
    "energy": pi.EnergyMomentum(h=5e-4),
}
ends = {}
for name, integrator in integrators.items():
    run = pi.solve(model, 0.2, integrator)
    assert run.success, (name, run.message)
    s = run.states("drive")
    assert s.shape == (len(run.t), 1) and s[0, 0] == 0.0
    ends[name] = np.r_[run.position("top")[-1], s[-1, 0]]
assert all(np.abs(end - ends["Radau"]).max() < 2e-4 for end in ends.values()), ends

# closed form of a lag behind a ramp of 0.1 s: s(t) = 1 - (T / 0.1) (exp(-(t - 0.1) / T) - exp(-t / T)) for t > 0.1
T = 0.05
assert abs(ends["Radau"][2] - (1 - T / 0.1 * (np.exp(-0.1 / T) - np.exp(-0.2 / T)))) < 1e-6

# 2. a disc rolls down a slope without slipping: it has gone g sin(a) t^2 / 3
a = np.deg2rad(20.0)
roll = pi.Scene(gravity=(0.0, -9.81))
disc = roll.add(pi.RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.1 * np.sin(a), 0.1 * np.cos(a)), name="disc"))
roll.add(pi.RollingDisc(pi.ground.at((0.0, 0.0), direction=(np.cos(a), -np.sin(a))), disc.at("c"), radius=0.1, name="contact"))
roll.add(pi.PointMass(disc.at("c"), 1e-9, name="centre"))
rolled = pi.solve(roll.build(), 1.0, pi.RadauIIA(rtol=1e-9))
assert rolled.success, rolled.message
way = np.linalg.norm(rolled.position("centre")[-1] - rolled.position("centre")[0])
assert abs(way - 9.81 * np.sin(a) / 3.0) < 1e-6, way

print("controlled:", {k: np.round(v, 6) for k, v in ends.items()}, "rolled", round(way, 6))
