"""Effect of each optimisation: the same run with and without it, its counts and CPU seconds.

An optimisation is switched off by a model that repeats the work, by a setting, or by an engine of the same code with a switch. Both sides
of a row differ only in this.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from polyida.assembly import equilibrium
from polyida.assembly import joints as joint_rows
from polyida.assembly.scene_model import SceneModel
from polyida.body.rigid_body import PointMass
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.ida.integrator import IDA
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.linear.dissection import symbolic_of
from polyida.linear.fronts import factorize, solve_fronts
from polyida.mesh import rectangle
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.scene import Scene
from skip import unasked
from skip.sides import done, plate_at, sides
from step_cost.measure import NO_FRAMES, H


class Wasteful(SceneModel):
    """A scene's model that counts calls and repeats `again`: "mass", "phi_q", "rates", "reaction_q", "velocity"."""

    def __init__(self, scene, again=""):
        super().__init__(scene.parts, scene.gravity)
        self.again, self.calls = again, Counter()
        if again in ("reaction_q", "velocity"):
            flag = {"reaction_q": "phi_q_varies", "velocity": "velocity_forces"}[again]
            self.needs = replace(self.needs, **{flag: True})

    def mass(self, q=None):
        if self.again == "mass":
            for name in ("_mass", "_even_mass"):
                self.__dict__.pop(name, None)
        self.calls["mass"] += "_mass" not in self.__dict__
        return super().mass(q)

    def residual(self, t, q, v, a, lam):
        if self.again == "mass":
            self.mass(q)
        return super().residual(t, q, v, a, lam)

    def phi_q(self, t, q):
        varies = self.again == "phi_q" or self.needs.driven or self.needs.phi_q_varies
        self.calls["phi_q"] += varies or "_phi_q" not in self.__dict__
        return self._slopes(t, q) @ self._points_of_q if self.again == "phi_q" else super().phi_q(t, q)

    def _rates(self, t, q, v):
        if self.again == "rates" or self.needs.driven:
            self.calls["rates"] += 1
            phi_t, bias = np.zeros((2, self.m))
            joint_rows.joint_rates(self.arrays.links, self.drives(t), self.dz(q), self.dz(v), phi_t, np.zeros(self.m), bias)
            return phi_t, bias
        return super()._rates(t, q, v)

    def reaction_q(self, t, q, lam):
        self.calls["reaction_q"] += 1
        return super().reaction_q(t, q, lam)

    def force_v(self, t, q, v):
        self.calls["velocity"] += 1
        return super().force_v(t, q, v)


def again(what, integrator):
    """An optimisation of the general path: a model that evaluates `what` once or never, against one that always evaluates it."""

    def measure(cells, t_end, repeats):
        def side(name):
            model = Wasteful(plates.double_plate(cells), name)

            def run():
                model.calls.clear()
                done(solve(model, t_end, integrator, every=NO_FRAMES))
                return model.calls[what]

            return run

        return sides(side(""), side(what), repeats)

    return measure


def settings(count, on, off):
    """A saving of the integrator: one setting or engine against another."""

    def measure(cells, t_end, repeats):
        model = plates.double_plate(cells).build()

        def side(integrator):
            return lambda: getattr(done(solve(model, t_end, integrator, every=NO_FRAMES)).counts, count)

        return sides(side(on), side(off), repeats)

    return measure


def engines(saving, count="factorizations"):
    """A saving that is a switch of an engine."""
    return lambda *size: settings(count, *ENGINES[saving])(*size)


@dataclass(frozen=True)
class Driven(GeneralizedAlpha):
    """Generalized-alpha by another engine: the class of its steps."""

    engine: type = Steps

    def _engine(self, model, counts, control):
        return self.engine(self, model, counts, control)


class OneByOne(Steps):
    """Compiled stretches of one step."""

    chunk_bytes = 1


class Forgetful(OneByOne):
    """The same with a new factor in every step."""

    def _stretch(self, *place):
        self.system = None
        return super()._stretch(*place)


class Unturned(Steps):
    """Compiled stretches whose factor stays in the frame in which it was made."""

    def _set_system(self, system):
        super()._set_system(system)
        if system is not None:
            system.corotated = system.corotated._replace(turns=False)


class FullNewton(OneByOne):
    """A matrix made anew in every iteration."""

    def _steps(self, method, first, last, frames):
        if method.max_iterations == 1:
            return super()._steps(method, first, last, frames)
        return self._full_newton(first, frames)


def no_border(cells, t_end, repeats):
    """A free plate has no point that a joint or a mass holds; a mass of a millionth of a gram makes one, with its columns and its border."""

    def side(loaded):
        scene = Scene(gravity=plates.GRAVITY)
        plate = scene.add(plate_at(rectangle(plates.LENGTH, plates.HEIGHT, cells=cells, seed=1), "plate", 0.0))
        if loaded:
            scene.add(PointMass(plate.section("right"), 1e-9, name="speck"))
        model = scene.build()
        return lambda: done(solve(model, t_end, GeneralizedAlpha(h=H), every=NO_FRAMES)).counts.solves

    return sides(side(False), side(True), repeats)


def shared_operator(cells, t_end, repeats):
    """Two plates on one mesh object, against two on equal meshes: bytes of the element arrays, CPU of the build."""

    def build(meshes):
        scene = Scene(gravity=plates.GRAVITY)
        upper, lower = (scene.add(plate_at(mesh, name, x)) for mesh, name, x in zip(meshes, ("upper", "lower"), (0.0, plates.LENGTH)))
        scene.add(Revolute(ground, upper.section("left")))
        scene.add(Revolute(upper.section("right"), lower.section("left")))
        s = scene.build().arrays.plates
        return sum(array.nbytes for array in (s.layout, s.corners, s.gradients, s.weights, s.pairs, s.indptr, s.indices, s.mass))

    one, two = (rectangle(plates.LENGTH, plates.HEIGHT, cells=cells, seed=1) for _ in range(2))
    return sides(lambda: build((one, one)), lambda: build((one, two)), repeats)


def single_precision(cells, t_end, repeats):
    """Ten solves with the factor in single precision, against double precision; counted: bytes of the factor."""
    model = plates.double_plate(cells).build()
    known, blocks = model.once(symbolic_of), np.empty((len(model.pattern[1]), 2, 2))
    equilibrium.tangent_blocks(model.arrays, np.zeros((model.n_nodes, 2)), None, 4.0 / H**2, 0.0, 1.0, blocks)

    def side(dtype):
        panels, x = factorize(known, blocks, dtype=dtype), np.empty(model.n, np.float32)

        def run():
            for _ in range(10):
                x[:] = 1.0
                solve_fronts(known, panels, x)
            return panels.nbytes

        return run

    return sides(side(np.float32), side(float), repeats)


def only_what_is_asked(cells, t_end, repeats):
    """A run alone, against one of which energies and stresses of every frame are computed: evaluations of them."""
    model = plates.double_plate(cells).build()

    def plain():
        done(solve(model, t_end, GeneralizedAlpha(h=H)))
        return 0

    def everything():
        run = done(solve(model, t_end, GeneralizedAlpha(h=H)))
        return len(run.energy.total) + len([run.stress(k) for k in range(len(run))])

    return sides(plain, everything, repeats)


def no_frames(cells, t_end, repeats):
    """Only the first and the last frame, against every frame."""
    model = plates.double_plate(cells).build()

    def keeping(every):
        return lambda: len(done(solve(model, t_end, GeneralizedAlpha(h=H), every=every)))

    return sides(keeping(NO_FRAMES), keeping(1), repeats)


ALPHA, KKT, GENERAL_IDA = GeneralizedAlpha(h=H), GeneralizedAlpha(h=H, linear="kkt"), IDA(linear="kkt")
ENGINES = {  # saving: with it, without it
    "co-rotated factor": (ALPHA, Driven(H, engine=Unturned)),
    "stale matrix": (Driven(H, engine=OneByOne), Driven(H, engine=FullNewton)),
    "factor kept": (Driven(H, engine=OneByOne), Driven(H, engine=Forgetful)),
    "compiled stretches": (ALPHA, Driven(H, engine=OneByOne)),
}
SAVINGS = {  # name: (what is counted, how it is switched off, measure)
    "constant mass": ("assemblies of M", "assembled at every residual, general path", again("mass", KKT)),
    "linear joints": ("evaluations of phi_q", "rebuilt whenever asked for, general IDA", again("phi_q", GENERAL_IDA)),
    "no motors: phi_t, bias": ("evaluations", "evaluated whenever asked for, general IDA", again("rates", GENERAL_IDA)),
    "no motors: reaction_q": ("evaluations", "Needs.phi_q_varies set, general path", again("reaction_q", KKT)),
    "no damping: dg/dv": ("evaluations", "Needs.velocity_forces set, general IDA", again("velocity", GENERAL_IDA)),
    "no border": ("solves", "a mass of next to nothing on a free plate", no_border),
    "co-rotated factor": ("factorizations", "the factor stays in its frame, compiled", engines("co-rotated factor")),
    "stale matrix": ("factorizations", "full Newton; both back in Python after each step", engines("stale matrix")),
    "factor kept": ("factorizations", "a new one every step; both back in Python after each", engines("factor kept")),
    "compiled stretches": ("steps", "back to Python after every step", engines("compiled stretches", "steps")),
    "compiled IDA callbacks": ("residuals", "general callbacks", settings("residuals", IDA(), GENERAL_IDA)),
    "single precision": ("bytes of the factor", "kept in double", single_precision),
    "shared operator": ("bytes of element arrays", "two equal meshes", shared_operator),
    "no energies, no stresses": ("evaluations", "of every frame", only_what_is_asked),
    "no frames": ("frames kept", "every frame", no_frames),
} | unasked.SAVINGS
FIXED = (
    "not switched off: M, phi_q of linear joints and dg/dv in the compiled steps, which have no code "
    "for it; the general path stands for them",
    "not switched off: tangents of plates that are undeformed or only turn: with one factor a run there are none",
)


def measure(saving, cells, t_end, repeats):
    """The row of one saving on two plates of `cells` cells over t_end, s."""
    counted, off, run = SAVINGS[saving]
    return {"counted": counted, "off": off} | run(cells, t_end, repeats)
