"""Short runs whose last states and counts stay as they are when code is rewritten: `python tests/golden.py --check` or `--write`.

States are compared bit by bit and counts exactly, on the machine that wrote `golden.json`. A run says "same", the relative size of what
rounding changed, or CHANGED: Radau IIA may change in the last bits whenever its kernels are compiled anew. Other machines round differently
too; the tests compare what is left of the states then (`test_golden.py`). A change of a number of a method is the only reason to write the
file anew.
"""

import argparse
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import polyida as pi

FILE = Path(__file__).with_name("golden.json")
TIMED = "alpha friction"  # it looks for events after as many steps as take some ms, and throws away those behind an event
COUNTS = "steps", "rejected", "residuals", "solves", "factorizations"
TURN = pi.profile.quintic(0.0, 0.6, duration=0.05)


@dataclass(frozen=True, eq=False)
class Spring(pi.ForceElement):
    """A stiffening spring between a place of the ground and a point, in Python."""

    a: object
    b: object
    name: str = "python spring"

    def sides(self):
        return self.a, self.b

    def forces(self, t, x, v):
        along = x[1] - x[0]
        pull = (30.0 + 5.0 * (along @ along)) * along
        return np.stack((pull, -pull))

    def energy(self, x):
        square = (x[1] - x[0]) @ (x[1] - x[0])
        return 15.0 * square + 1.25 * square**2


class Slider(pi.Model):
    """A mass in polar coordinates on a curve that moves: every term of r and phi."""

    n, m = 2, 1

    def mass(self, q):
        return np.diag(np.array([2.0, 2.0 * q[0] ** 2]))

    def force(self, t, q, v):
        along = -2.0 * q[0] * v[1] ** 2 + 3.0 * q[0] + 0.5 * v[0]
        return np.array([along, 4.0 * q[0] * v[0] * v[1] + np.sin(q[1]) + np.cos(t)])

    def phi(self, t, q):
        return np.array([q[0] - np.exp(0.3 * t) * np.cos(q[1])])

    def phi_q(self, t, q):
        return np.array([[1.0, np.exp(0.3 * t) * np.sin(q[1])]])


class Skate(pi.Model):
    """A skate (x, y, angle) on a slope: a velocity row."""

    n, m, p = 3, 0, 1

    def mass(self, q):
        return np.eye(3)

    def force(self, t, q, v):
        return np.array([-2.0, 0.0, 0.0])

    def potential(self, q):
        return -2.0 * q[0]

    def psi(self, t, q, v):
        return np.array([v[1] * np.cos(q[2]) - v[0] * np.sin(q[2])])


def chain(bars=3):
    """Rigid bars on pins."""
    scene, before = pi.Scene(gravity=(0.0, -9.81)), pi.ground.at((0.0, 0.0))
    for k in range(bars):
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, (k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(before, bar.at("left"), name=f"pin {k}"))
        before = bar.at("right")
    return scene, before


def plates(motor=False, **material):
    """Two rubber plates of 12 cells on pins; the elbow moves by a motor, or hangs free."""
    scene, rubber = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, **material)
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1)
    upper = scene.add(pi.Plate(mesh, rubber, 0.01, name="upper"))
    lower = scene.add(pi.Plate(mesh, rubber, 0.01, origin=(1.0, 0.0), name="lower"))
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="shoulder"))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
    if motor:
        scene.add(pi.AngleMotor(upper.section("right"), lower.section("left"), TURN, name="motor"))
    return scene.build()


def python_spring():
    scene, end = chain()
    scene.add(Spring(pi.ground.at((0.0, -3.0)), end))
    return scene.build()


def rubbing():
    """A block that slides on a rail with friction until it stops."""
    scene, rail = pi.Scene(gravity=(0.0, -9.81)), pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
    block = scene.add(pi.RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, velocity=(0.1, 0.0), name="block"))
    scene.add(pi.Prismatic(rail, block.at("c", direction=(1.0, 0.0)), friction=0.3, name="rail"))
    return scene.build()


ALPHA, RADAU, ENERGY = pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(h=2e-3), pi.EnergyMomentum(h=1e-3)
IDA, STEPPING = pi.IDA(rtol=1e-6), pi.NonsmoothAlpha(h=1e-3)
POLAR = {"q0": [1.0, 0.0], "v0": [0.3, 0.0]}
TURNING = {"v0": [0.0, 0.0, 1.5]}
ROUNDING = 1e-9  # relative; what is larger is no rounding of one machine
RUNS = {  # name: a model's function, integrator, initial values
    "alpha chain": (lambda: chain()[0].build(), ALPHA, {}),
    "alpha stabilised chain": (lambda: chain()[0].build(), pi.GeneralizedAlpha(h=1e-3, form="stabilised"), {}),
    "alpha adaptive chain": (lambda: chain()[0].build(), pi.GeneralizedAlpha(rtol=1e-5), {}),
    "alpha plates": (plates, ALPHA, {}),
    "alpha driven plates": (lambda: plates(motor=True), ALPHA, {}),
    "alpha strains": (lambda: plates(prony=[(0.3, 0.01)]), ALPHA, {}),
    "alpha viscous": (lambda: plates(viscosity=1e-3), ALPHA, {}),
    "alpha python force": (python_spring, ALPHA, {}),
    "alpha friction": (rubbing, ALPHA, {}),
    "alpha dense": (pi.compiled(Slider), ALPHA, POLAR),
    "alpha Python": (Slider, ALPHA, POLAR),
    "alpha velocity rows": (Skate, ALPHA, TURNING),
    "Radau chain": (lambda: chain()[0].build(), RADAU, {}),
    "Radau adaptive plates": (plates, pi.RadauIIA(rtol=1e-5), {}),
    "Radau driven plates": (lambda: plates(motor=True), RADAU, {}),
    "Radau strains": (lambda: plates(prony=[(0.3, 0.01)]), RADAU, {}),
    "Radau index3 chain": (lambda: chain()[0].build(), pi.RadauIIA(h=2e-3, form="index3"), {}),
    "Radau python force": (python_spring, RADAU, {}),
    "Radau dense": (pi.compiled(Slider), RADAU, POLAR),
    "Radau Python": (Slider, RADAU, POLAR),
    "Radau velocity rows": (Skate, RADAU, TURNING),
    "energy chain": (lambda: chain()[0].build(), ENERGY, {}),
    "energy driven plates": (lambda: plates(motor=True), ENERGY, {}),
    "energy python force": (python_spring, ENERGY, {}),
    "energy velocity rows": (Skate, ENERGY, TURNING),
    "IDA chain": (lambda: chain()[0].build(), IDA, {}),
    "IDA driven plates": (lambda: plates(motor=True), IDA, {}),
    "IDA python force": (python_spring, IDA, {}),
    "IDA dense": (pi.compiled(Slider), IDA, POLAR),
    "IDA velocity rows": (Skate, IDA, TURNING),
    "nonsmooth friction": (rubbing, STEPPING, {}),
    "Moreau friction": (rubbing, pi.MoreauJean(h=1e-3), {}),
}
SWEEPS = {  # runs whose gradient of the sum of q at the end is taken too
    "alpha driven plates": ["motor.end", "upper.E"],
    "alpha strains": ["upper.rho"],
    "alpha dense": ["v0"],
    "Radau chain": ["v0", "bar 1.mass"],
    "Radau driven plates": ["motor.end", "upper.E"],
}


def slope_of_total(run):
    """The slope of the sum of q at the end."""
    slope = np.zeros(run.q.shape)
    slope[-1] = 1.0
    return {"q": slope}


def result(name):
    """{"counts", "digest", "sizes"} of one run."""
    make, integrator, start = RUNS[name]
    run = pi.solve(make(), 0.05, integrator, **start)
    assert run.success, run.message
    state = {"q": run.q[-1], "v": run.v[-1], "lam": run.lam[-1]}
    counts = {count: int(getattr(run.counts, count)) for count in (COUNTS if name != TIMED else ["steps"])}
    if name in SWEEPS:
        total = pi.objective.UserObjective(lambda run: float(run.q[-1].sum()), slope_of_total)
        state |= {what: np.asarray(slope) for what, slope in pi.gradient(run, total, parameters=SWEEPS[name]).items()}
    return {"counts": counts} | described(state)


def described(state):
    """The digest of a state's bits and its largest and summed entries, by which other machines compare."""
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(x, float).tobytes() for x in state.values())).hexdigest()[:16]
    return {"digest": digest, "sizes": {what: [float(np.abs(x).max(initial=0.0)), float(x.sum())] for what, x in state.items()}}


def difference(found, before):
    """In words: how a result differs from that of the file."""
    if found == before:
        return "same"
    pairs = [(found["sizes"][what], sizes) for what, sizes in before["sizes"].items()]
    largest = max(abs(new - old) / (sizes[0] + 1e-15) for values, sizes in pairs for new, old in zip(values, sizes))
    if found["counts"] == before["counts"] and largest < ROUNDING:
        return f"same counts, rounding {largest:.0e}"
    return f"CHANGED by {largest:.1e}: {before} -> {found}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    found = {name: result(name) for name in RUNS}
    if options.write:
        FILE.write_text(json.dumps(found, indent=1) + "\n")
    for name, before in json.loads(FILE.read_text()).items() if options.check else ():
        print(f"{name:28} {difference(found[name], before)}")
