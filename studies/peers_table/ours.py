"""Checks of polyida, on the same pendulum and on small scenes."""

import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import polyida as pi
from peers_table.rows import GRAVITY, T_END, NotThere, require, swung


class Pendulum(pi.Model):
    """A mass of 1 kg on a rod of 1 m."""

    n, m = 2, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, GRAVITY])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2.0 * q[None]

    def potential(self, q):
        return GRAVITY * q[1]


LEVEL = {"q0": [1.0, 0.0]}
RUBBER = pi.Material(E=50e6, nu=0.3, rho=1100.0)


def run_of(integrator, t_end=T_END, **options):
    """A run of the pendulum."""
    run = pi.solve(Pendulum(), t_end, integrator, **LEVEL, **options)
    require(run.success, run.message)
    return run


def swings(integrator, bound):
    return swung(run_of(integrator).q[-1], bound)


def spatial():
    """A rigid body with a position in space."""
    try:
        pi.RigidBody(mass=1.0, inertia=1.0, points={"A": (0.0, 0.0, 0.0)}, origin=(0.0, 0.0, 0.0))
    except pi.InputError as error:
        raise NotThere(str(error)) from None
    return "a body in space"


def plate(cells=60, **options):
    return pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=cells, seed=1), RUBBER, 0.01, **options)


def polygons():
    corners = np.diff(plate().mesh.offsets)
    require(corners.max() > 4, f"cells of {corners} corners")
    return f"cells of {corners.min()} to {corners.max()} corners"


def scene_of(part):
    """(scene, part) of a part of a plate on a revolute joint, with weight."""
    scene = pi.Scene(gravity=(0.0, -GRAVITY))
    body = scene.add(part)
    scene.add(pi.Revolute(pi.ground, body.section("left"), name="pin"))
    scene.add(pi.PointMass(body.section("right"), 0.1, name="tip"))
    return scene


def falls(part):
    """A part of a plate swings by more than 1 rad on its joint and keeps its energy."""
    run = pi.solve(scene_of(part).build(), T_END, pi.GeneralizedAlpha(h=1e-3))
    require(run.success, run.message)
    tip, change = run.position("tip")[-1], abs(run.energy.total[-1] - run.energy.total[0])
    require(tip[1] < -0.8, f"the tip is at {tip}")
    return f"its tip falls by {-tip[1]:.2f} m; energy changes by {change:.1e} J"


def joints():
    """A wheel is turned by a motor; a block slides; a bar hangs on a pin."""
    scene = pi.Scene(gravity=(0.0, -GRAVITY))
    wheel, block = (scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"O": (0.0, 0.0)}, origin=(x, 0.0))) for x in (0.0, 1.0))
    scene.add(pi.Revolute(pi.ground, wheel.at("O"), name="pin"))
    scene.add(pi.AngleMotor(pi.ground, wheel.at("O"), angle=pi.profile.quintic(0.0, 1.0, duration=T_END), name="motor"))
    scene.add(pi.Prismatic(pi.ground.at((1.0, 0.0), direction=(0.0, 1.0)), block.at("O"), name="guide"))
    run = pi.solve(scene.build(), T_END, pi.GeneralizedAlpha(h=1e-3))
    require(run.success, run.message)
    turned, reaction = run.angle("motor")[-1], np.abs(run.reaction("guide")[-1]).max()
    require(abs(turned - 1.0) < 1e-6 and reaction < 1e-6, f"turned by {turned}, guide {reaction} N")
    return f"a wheel turned by {turned:.6f} rad of 1, a block slides with {reaction:.0e} N on its guide"


def friction():
    """A block slides to rest on the ground."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    points = {"left": (-0.1, -0.01), "right": (0.1, -0.01)}
    block = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points=points, origin=(0.0, 0.01), velocity=(1.0, 0.0), name="block"))
    for name in points:
        scene.add(pi.Contact(block.at(name), pi.ground.at((0.0, 0.0)), friction=0.3, name=name))
    run = pi.solve(scene.build(), 0.5, pi.NonsmoothAlpha(h=1e-3))
    way, exact = run.q[-1, 0], 1.0 / (2 * 0.3 * 9.81)
    require(run.success and abs(way - exact) < 1e-4, f"{run.message}: {way} m of {exact}")
    return f"a block slides to rest after {way:.6f} m of {exact:.6f}"


def every_integrator():
    """The same model through all four."""
    bounds = {pi.GeneralizedAlpha(h=1e-3): 1e-4, pi.EnergyMomentum(h=1e-3): 1e-4, pi.IDA(rtol=1e-7): 1e-4, pi.RadauIIA(rtol=1e-7): 1e-4}
    return "; ".join(f"{type(integrator).__name__}: {swings(integrator, bound)}" for integrator, bound in bounds.items())


def condition(scaling, h):
    state = run_of(pi.GeneralizedAlpha(h=1e-2), 0.1).state
    return pi.condition_number(Pendulum(), pi.GeneralizedAlpha(h=h, scaling=scaling), state)


def scaled():
    scaled_, raw = (condition(scaling, 1e-5) for scaling in ("bottasso", "none"))
    require(raw > 1e6 * scaled_, f"{scaled_:.1e} and {raw:.1e}")
    return f"condition number at h = 1e-5: {scaled_:.1e}, without scaling {raw:.1e}"


def order():
    """Few steps at high orders."""
    steps = [run_of(pi.IDA(rtol=1e-6, max_order=order)).counts.steps for order in (1, 5)]
    require(steps[1] < steps[0] / 2, f"{steps}")
    return f"{steps[1]} steps with orders up to 5, {steps[0]} with order 1"


def energy_conserved():
    """Energy over ten seconds."""
    run = run_of(pi.EnergyMomentum(h=1e-2), 10.0)
    energy = np.sum(run.v**2, axis=1) / 2 + GRAVITY * run.q[:, 1]
    require(np.ptp(energy) < 1e-6, f"{np.ptp(energy):.1e} J")
    return f"energy stays within {np.ptp(energy):.1e} J over 10 s at h = 1e-2"


@dataclass(frozen=True)
class Projected:
    """Symplectic Euler with q and v put back on the constraint of a mass matrix of 1: a user-defined integrator."""

    h: float

    def steps(self, model, state, t_end, counts):
        count = round((t_end - state.t) / self.h)
        t, q, v = state.t, np.array(state.q), np.array(state.v)
        for k in range(count):
            v = v - self.h * model.force(t, q, v)
            B = model.phi_q(t, q)
            v = v - B.T @ np.linalg.solve(B @ B.T, B @ v)
            q, t = q + self.h * v, t + self.h
            for _ in range(3):
                B = model.phi_q(t, q)
                q = q - B.T @ np.linalg.solve(B @ B.T, model.phi(t, q))
            counts.steps += 1
            yield pi.State(t_end if k == count - 1 else t, q, v, np.zeros(2), np.zeros(1))


def precision():
    """A small work-precision study of the pendulum, its reference by two families."""
    steps = (1e-2, 5e-3)
    integrators = {"generalized-alpha": [pi.GeneralizedAlpha(h=h) for h in steps], "own": [Projected(h=h) for h in steps]}
    study = pi.study.work_precision(Pendulum(), T_END, **LEVEL, integrators=integrators)
    require(len(study.rows) == 4 and all(row["status"] == "done" for row in study.rows), f"{study.rows}")
    methods, known = study.reference["made_by"], study.known_to["q"]
    require(len(methods) > 1 and known < 1e-8, f"reference by {methods}, known to {known}")
    return f"{len(study.rows)} rows, a reference by {' and '.join(methods)}, known to {known:.1e} m"


def side_by_side():
    """Three pendulums on two threads, one of which fails and is a row."""
    with ThreadPoolExecutor(2) as pool:
        rows = pi.study.sweep(swung_by, [{"h": h} for h in (1e-2, 5e-3, -1.0)], executor=pool).rows
    ends = [row.get("x") for row in rows]
    require(ends[0] and ends[1] and rows[2]["error"], f"{rows}")
    return f"3 rows, the last with the error {rows[2]['error'][:60]}"


def swung_by(h):
    return {"x": float(run_of(pi.GeneralizedAlpha(h=h)).q[-1, 0])}


def counted():
    counts = run_of(pi.GeneralizedAlpha(h=1e-2)).counts
    result = {name: getattr(counts, name) for name in ("steps", "newton_iterations", "residuals", "tangents", "factorizations")}
    require(min(result.values()) > 0, f"{result}")
    return ", ".join(f"{name} {value}" for name, value in result.items())


def linear():
    """Rest, modes and the matrices of the state space of a clamped plate."""
    scene = pi.Scene(gravity=(0.0, -GRAVITY))
    bar = scene.add(plate(name="bar"))
    scene.add(pi.Clamp(pi.ground, bar.section("left"), name="clamp"))
    scene.add(pi.PointMass(bar.section("right"), 0.01, name="tip"))
    model = scene.build()
    state = pi.static(model)
    first, matrices = pi.modes(model, state).frequencies[0], pi.linearise(model, state)
    require(first > 0 and np.isfinite(matrices.A).all(), f"{first} Hz")
    return f"a clamped plate at rest, its first frequency {first:.3g} Hz, a state space with A of {matrices.A.shape}"


KILLED = """
import os, sys
sys.path.insert(0, sys.argv[2])
import polyida as pi
from peers_table.ours import LEVEL, Pendulum
pi.solve(Pendulum(), 0.5, pi.GeneralizedAlpha(h=1e-3), **LEVEL, out=sys.argv[1], flush_every=10, progress=lambda t: t > 0.25 and os._exit(9))
"""


def goes_on():
    """A process ends without a word in the middle of a run; its file is read, and the run goes on from it."""
    with tempfile.TemporaryDirectory() as folder:
        path, beside = Path(folder) / "run.h5", str(Path(__file__).parents[1])
        ended = subprocess.run([sys.executable, "-c", KILLED, str(path), beside], capture_output=True, text=True)
        require(ended.returncode == 9, ended.stderr[-300:])
        frames = len(pi.load(path).t)
        run = pi.resume(path, model=Pendulum())
    return f"{frames} frames of a process that died; {swung(run.q[-1], 1e-4)}"


CHECKS = {
    "bodies in three dimensions": spatial,
    "polygonal elements": polygons,
    "plates or solids under large rotation": lambda: falls(plate(name="plate")),
    "flexible bodies reduced to modes": lambda: falls(pi.Reduced(plate(name="plate"), modes=5)),
    "revolute, prismatic, motor": joints,
    "contact with friction": friction,
    "a model of one's own": every_integrator,
    "generalized-alpha on index 3": lambda: swings(pi.GeneralizedAlpha(h=1e-3), 1e-4),
    "matrix scaled by the step": scaled,
    "stabilised index 2 (GGL)": lambda: swings(pi.IDA(form="ggl2", rtol=1e-7), 1e-4),
    "BDF of variable order": order,
    "Radau IIA": lambda: swings(pi.RadauIIA(rtol=1e-7), 1e-4),
    "energy-momentum": energy_conserved,
    "an integrator of one's own": lambda: swings(Projected(h=1e-3), 1e-2),
    "condition number of the iteration matrix": scaled,
    "work-precision studies": precision,
    "counts of the work": counted,
    "statics, modes, linearisation": linear,
    "many runs beside each other": side_by_side,
    "a run that was killed goes on": goes_on,
}
