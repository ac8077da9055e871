"""Unused results: solves of a scene at rest, velocities and accelerations of frames that are not stored."""

import numpy as np

from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_state, on_velocity
from polyida.integrate.state import Counts, State
from polyida.integrate.static import static
from polyida.joint.attachment import ground
from polyida.joint.formula import cross
from polyida.joint.joint import Joint
from polyida.joint.joints import Clamp, Revolute
from polyida.mesh import rectangle
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.scene import Scene
from skip.sides import done, plate_at, sides
from step_cost.measure import NO_FRAMES, H

TOUCH = 1e-6  # m/s


class Slot(Joint):
    """`phi = d_A x (x_B - x_A)`: rows that turn with a, which velocities leave by a little in every step."""

    def rows(self):
        return [cross(self.a.d, self.b.x - self.a.x)]


def rest(count):
    """A clamped plate in equilibrium, against the same with the speed of a touch."""

    def measure(cells, t_end, repeats):
        scene = Scene(gravity=plates.GRAVITY)
        plate = scene.add(plate_at(rectangle(plates.LENGTH, plates.HEIGHT, cells=cells, seed=1), "plate", 0.0))
        scene.add(Clamp(ground, plate.section("left")))
        model = scene.build()
        still = static(model)
        v = on_velocity(model, still.t, still.q, np.tile([0.0, TOUCH], model.n // 2))
        touched = State(still.t, still.q, v, still.a, still.lam, still.memory)

        def side(state):
            return lambda: getattr(done(solve(model, t_end, GeneralizedAlpha(h=H), state=state, every=NO_FRAMES)).counts, count)

        return sides(side(still), side(touched), repeats)

    return measure


def of_frames(name, method):
    """Steps of which nothing is asked, against the same steps asked for `name`, which their motion does not need."""

    def measure(cells, t_end, repeats):
        scene, mesh = Scene(gravity=plates.GRAVITY), rectangle(plates.LENGTH, plates.HEIGHT, cells=cells, seed=1)
        upper, lower = (scene.add(plate_at(mesh, name, x)) for name, x in (("upper", 0.0), ("lower", plates.LENGTH)))
        scene.add(Revolute(ground, upper.section("left")))
        scene.add(Slot(upper.section("right"), lower.section("left")))
        model = scene.build()
        start = consistent_state(model)

        def side(asked):
            return lambda: sum(asked and getattr(state, name) is not None for state in method.steps(model, start, t_end, Counts()))

        return sides(side(False), side(True), repeats)

    return measure


SAVINGS = {  # as those of savings.py
    "rest": ("solves", f"a touch: {1e6 * TOUCH:g} um/s", rest("solves")),
    "rest, residuals": ("residuals", f"a touch: {1e6 * TOUCH:g} um/s", rest("residuals")),
    "no frames: v": ("velocities on their constraint", "of every step, energy-momentum", of_frames("v", EnergyMomentum(h=H))),
    "no frames: a, lam": ("consistent accelerations", "of every step, Radau IIA", of_frames("a", RadauIIA(h=5 * H))),
}
