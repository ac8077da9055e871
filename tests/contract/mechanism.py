"""A slider crank as people draw it: rigid crank, flexible rod, guided slider, spring-damper, torque; then its modes."""

import numpy as np

import polyida as pi

r, l = 0.15, 0.3
steel = pi.Material(E=2.0e9, nu=0.3, rho=1200.0)
x_slider = np.sqrt(l**2 - r**2)

scene = pi.Scene(gravity=(0.0, -9.81))
crank = scene.add(
    pi.RigidBody(mass=0.4, inertia=1e-3, points={"O": (-r / 2, 0.0), "A": (r / 2, 0.0)}, origin=(0.0, r / 2), angle=np.pi / 2, name="crank")
)
rod = scene.add(
    pi.Plate(pi.mesh.rectangle(l, 0.02, cells=60, seed=1), steel, thickness=0.01, origin=(0.0, r), angle=-np.arcsin(r / l), name="rod")
)
slider = scene.add(pi.RigidBody(mass=0.5, inertia=1e-3, points={"B": (0.0, 0.0)}, origin=(x_slider, 0.0), name="slider"))
guide = pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
wall = pi.ground.at((0.8, 0.0))
scene.add(pi.Revolute(pi.ground, crank.at("O"), name="bearing"))
scene.add(pi.Revolute(crank.at("A"), rod.section("left"), name="crank pin"))
scene.add(pi.Revolute(rod.section("right"), slider.at("B"), name="wrist pin"))
scene.add(pi.Prismatic(guide, slider.at("B"), name="guide"))
scene.add(pi.SpringDamper(wall, slider.at("B"), stiffness=200.0, damping=2.0, length=0.4, name="spring"))
scene.add(pi.Torque(crank.at("O"), pi.profile.quintic(0.0, 0.8, 0.1), name="drive"))
model = scene.build()
assert max(pi.check_derivatives(model).values()) < 1e-6

tips = {}
for name, integrator in {"alpha": pi.GeneralizedAlpha(h=2e-4), "IDA": pi.IDA(rtol=1e-6, atol=1e-8)}.items():
    run = pi.solve(model, 0.12, integrator)
    assert run.success, run.message
    pin = run.position("crank pin")
    assert np.abs(np.hypot(*pin.T) - r).max() < 1e-9, "the crank is rigid"
    assert np.abs(run.position("wrist pin")[:, 1]).max() < 1e-9, "the guide holds"
    balance = run.energy.total - run.energy.total[0] - run.energy.work["drive"] + run.energy.dissipated["spring"]
    assert np.abs(balance).max() < 2e-3 * np.abs(run.energy.work["drive"]).max(), "energy is accounted for"
    tips[name] = run.position("wrist pin")[-1, 0]
assert abs(tips["alpha"] - tips["IDA"]) < 2e-5, tips

# reaction of the bearing against Newton's law of the whole
momentum = run.momentum  # (frames, 2), N s
assert momentum.shape == (len(run.t), 2)

# static equilibrium, then linear modes about it: constraints honoured, frequencies in Hz, shapes as displacements
hanging = pi.Scene(gravity=(0.0, -9.81))
bar = hanging.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=400, seed=1), pi.Material(E=50e6, nu=0.3, rho=1100.0), thickness=0.01))
hanging.add(pi.Clamp(bar.section("left")))
modes = pi.modes(hanging.build(), count=3)
assert np.allclose(modes.frequencies, [3.421, 20.52, 53.36], rtol=0.01), modes.frequencies  # Hz, fine quadratic elements
assert modes.shapes.shape == (3, hanging.build().n)
about = pi.modes(hanging.build(), state=pi.static(hanging.build()), count=3)
assert about.frequencies[0] > 0.0


# the same body at three levels, by one word
def double(body):
    made = pi.Scene(gravity=(0.0, -9.81))
    mesh, rubber = pi.mesh.rectangle(1.0, 0.1, cells=160, seed=1), pi.Material(E=500e6, nu=0.3, rho=1100.0)
    a = made.add(body(pi.Plate(mesh, rubber, thickness=0.01, name="a")))
    b = made.add(body(pi.Plate(mesh, rubber, thickness=0.01, origin=(1.0, 0.0), name="b")))
    made.add(pi.Revolute(pi.ground, a.section("left")))
    made.add(pi.Revolute(a.section("right"), b.section("left")))
    made.add(pi.PointMass(b.section("right"), 0.5, name="tip"))
    return made.build()


levels = {"full": lambda plate: plate, "reduced": lambda plate: pi.Reduced(plate, modes=5), "rigid": pi.Rigid}
ends = {name: pi.solve(double(body), 1.0, pi.GeneralizedAlpha(h=5e-4)) for name, body in levels.items()}
gap = {name: np.linalg.norm(run.position("tip") - ends["full"].position("tip"), axis=1).max() for name, run in ends.items()}
assert gap["reduced"] < 1e-4 and gap["rigid"] < 2e-3, gap
assert ends["reduced"].model.n <= 32 and ends["reduced"].stress(-1).shape == ends["full"].stress(-1).shape
print("mechanism: tips", tips, "modes", modes.frequencies, "gaps", gap)
