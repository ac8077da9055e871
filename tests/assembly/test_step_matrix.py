"""A scene's step matrix: its solves against those of the tangent, at the state of the factor and turned from there."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.scene_step_matrix import SceneStepMatrix

DAMPED = {"viscosity": 1e-3, "mass_damping": 300.0}


@pi.compiled
@dataclass(frozen=True, eq=False)
class Pull(pi.ForceElement):
    """Whose slopes are not symmetric."""

    a: object
    b: object
    k: float
    d: float
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        first = -self.k * x[0] - self.d * (v[0] + 0.5 * x[0, ::-1])
        return np.stack((first, self.k * (x[0] - x[1]) - self.d * v[0, ::-1]))


def free(scenes):
    return scenes.single()[0]


def pulled(scenes):
    scene, upper = scenes.hinged(material=DAMPED)
    scene.add(Pull(upper.section("right"), upper.section("top"), 3e5, 1e3))
    scene.add(pi.PointMass(upper.section("right"), 0.5))
    return scene


SCENES = {
    "free": free,
    "held": lambda scenes: scenes.cantilever()[0],
    "damped": lambda scenes: scenes.jointed("motor between", material=DAMPED),
    "driven": lambda scenes: scenes.jointed("motor to ground"),
    "two": lambda scenes: scenes.jointed("clamp between"),
    "laws": pulled,
}


@pytest.fixture(params=SCENES)
def bent(scenes, request):
    """(model, a state with every joint at work)."""
    model, random = SCENES[request.param](scenes).build(), np.random.default_rng(2)
    return model, (0.1, 1e-3 * random.standard_normal(model.n), np.zeros(model.n), np.zeros(model.n), random.standard_normal(model.m))


@pytest.fixture(params=[2e3, 2e3 * (0.66 + 0.75j)], ids=["real", "complex"])
def c(request):
    """The step matrix's c; the real one is for c_m = c^2, c_v = c."""
    return request.param


def numbers(c, *shape):
    """Random numbers, complex where c is."""
    random = np.random.default_rng(3)
    return random.standard_normal(shape) + (1j * random.standard_normal(shape) if np.iscomplexobj(c) else 0.0)


def whole(model, state, c):
    """S = K + c C + c^2 M."""
    K = model.tangent(*state, 0.0, 0.0, 1.0).toarray()
    return K + c * (model.force_v(*state[:3]).toarray() if model.needs.velocity_forces else 0.0) + c * c * model.mass(state[1]).toarray()


def near(found, exact):
    """To single precision, which the factor is in."""
    return found.dtype == exact.dtype and np.abs(found - exact).max(initial=0.0) < 1e-4 * np.abs(exact).max(initial=1e-300)


def test_a_solve_is_that_of_the_tangent(bent, c):
    model, state = bent
    system, b = SceneStepMatrix(model), numbers(c, model.n, 2)
    system.factor(*state, c * c, c)
    S = whole(model, state, c)
    assert near(system.solve(state[1], b), np.linalg.solve(S, b))
    assert near(system.solve(state[1], b[:, 0], transposed=True), np.linalg.solve(S.T, b[:, 0]))


def test_the_saddle_is_that_of_the_tangent(bent, c):
    model, (t, q, v, a, lam) = bent
    system, r, phi, B = SceneStepMatrix(model), numbers(c, model.n), numbers(c, model.m), model.phi_q(t, q).toarray()
    system.factor(t, q, v, a, lam, c * c, c)
    S = whole(model, (t, q, v, a, lam), c)
    exact = -np.linalg.solve(np.block([[S, B.T], [B, np.zeros((model.m, model.m))]]), np.concatenate([r, phi]))
    dq, dlam = system.saddle(t, q, lam, r, phi)
    assert near(dq, exact[: model.n]) and near(dlam, exact[model.n :])
    assert np.allclose(B @ dq, -phi, rtol=1e-10)


def test_a_complex_matrix_turns_with_its_bodies(scenes, c):
    """The factor of the unturned scene solves the turned one as a fresh factor does, phi to round-off."""
    model = scenes.jointed("clamp between").build()
    zero, lam, r, phi = np.zeros(model.n), np.zeros(model.m), numbers(c, model.n), 1e-3 * numbers(c, model.m)
    q, stale, fresh = scenes.turned(model, zero, 0.7), SceneStepMatrix(model), SceneStepMatrix(model)
    stale.factor(0.0, zero, zero, zero, lam, c * c, c)
    fresh.factor(0.0, q, zero, zero, lam, c * c, c)
    (dq, dlam), exact = stale.saddle(0.0, q, lam, r, phi), fresh.saddle(0.0, q, lam, r, phi)
    assert near(dq, exact[0]) and near(dlam, exact[1])
    assert np.allclose(model.phi_q(0.0, q) @ dq, -phi, rtol=1e-10)


def test_a_matrix_may_be_indefinite(scenes, c):
    """Far compressed: K falls in some directions by more than c^2 M rises."""
    model = scenes.single()[0].build()
    zero, q, b = np.zeros(model.n), -0.6 * model.reference.ravel(), numbers(c, model.n)
    state, system, c = (0.0, q, zero, zero, zero[:0]), SceneStepMatrix(model), 0.1 * c
    system.factor(*state, c * c, c)
    assert np.linalg.eigvalsh(whole(model, state, c).real)[0] < 0.0
    assert near(system.solve(q, b), np.linalg.solve(whole(model, state, c), b))
