"""Forces of one's own: in every integrator, in energies and derivatives, in files; and what is wrong with one is told."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi


@dataclass(frozen=True, eq=False)
class Pull(pi.ForceElement):
    """A spring and a damper between two points, N, of rest length 0."""

    a: object
    b: object
    k: float = 20.0
    d: float = 0.0
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        pull = self.k * (x[1] - x[0]) + self.d * (v[1] - v[0])
        return np.stack([pull, -pull])

    def energy(self, x):
        return 0.5 * self.k * float((x[1] - x[0]) @ (x[1] - x[0]))


@dataclass(frozen=True, eq=False)
class Exact(Pull):
    """The same with its derivatives."""

    def forces_x(self, t, x, v):
        return self.k * np.einsum("ab,ij->aibj", [[-1.0, 1.0], [1.0, -1.0]], np.eye(2))

    def forces_v(self, t, x, v):
        return self.d * np.einsum("ab,ij->aibj", [[-1.0, 1.0], [1.0, -1.0]], np.eye(2))


@dataclass(frozen=True, eq=False)
class Push(pi.ForceElement):
    """Forces by any function of t, x and v."""

    at: object
    function: object
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return self.function(t, x, v)


def pulled(scenes, kind=Pull, **options):
    scene, upper = scenes.hinged()
    scene.add(kind(pi.ground.at((0.5, -2.0)), upper.section("right"), **options))
    return scene.build()


def test_a_constant_force_is_a_point_load(scenes):
    ends = []
    for make in (lambda at: pi.PointLoad(at, (0.0, 3.0)), lambda at: Push(at, lambda t, x, v: np.array([[0.0, 3.0]]))):
        scene, upper = scenes.hinged()
        scene.add(make(upper.section("right")))
        run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-10))
        assert run.success, run.message
        ends.append(run.q[-1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


def test_every_integrator_takes_it_and_says_so(scenes):
    model = pulled(scenes, d=2.0, name="spring")
    h = 2.5e-4
    methods = pi.IDA(rtol=1e-6), pi.GeneralizedAlpha(h=h), pi.EnergyMomentum(h=h), pi.GeneralizedAlpha(h=h, form="stabilised")
    runs = [pi.solve(model, 0.05, method) for method in methods]
    for run in runs:
        assert run.success and "Python of 'spring'" in run.summary(), run.message
        assert np.abs(run.q[-1] - runs[0].q[-1]).max() < 1e-4


def test_energy_is_kept_and_counts_it(scenes):
    run = pi.solve(pulled(scenes), 0.2, pi.EnergyMomentum(h=2e-3))
    assert np.ptp(run.energy.total) < 1e-9 * np.ptp(run.energy.potential)
    assert run.energy.potential[0] == pytest.approx(0.5 * 20.0 * (0.5**2 + 2.0**2), rel=1e-9)


def test_derivatives(scenes):
    state = pi.solve(pulled(scenes, d=2.0), 0.02, pi.GeneralizedAlpha(h=1e-3)).state
    for kind in (Pull, Exact):
        found = pi.check_derivatives(pulled(scenes, kind, d=2.0), q=state.q, v=state.v)
        assert max(found.values()) < 1e-6


def test_a_wrong_derivative_is_seen(scenes):
    class Wrong(Exact):
        def forces_v(self, t, x, v):
            return 1.1 * super().forces_v(t, x, v)

    model = pulled(scenes, Wrong, d=200.0)
    assert pi.check_derivatives(model, q=np.zeros(model.n))["force_v"] > 0.05


def test_files_hold_it(scenes, tmp_path):
    run = pi.solve(pulled(scenes, d=2.0), 5e-3, pi.GeneralizedAlpha(h=1e-3))
    run.save(tmp_path / "run.h5")
    loaded = pi.load(tmp_path / "run.h5")
    assert isinstance(loaded.model.parts["pull 1"], Pull)
    assert np.array_equal(loaded.energy.total, run.energy.total)


WRONG = {
    "must return real numbers of shape": lambda t, x, v: np.zeros(2),
    "writes into its arguments": lambda t, x, v: np.multiply(x, 0.0, out=x),
    "gave numbers that are not finite": lambda t, x, v: np.nan * x,
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_is_told_before_the_run(scenes, words):
    scene, upper = scenes.hinged()
    scene.add(Push(upper.section("right"), WRONG[words], name="push"))
    with pytest.raises(pi.InputError, match=f"push.*{words}|{words}.*push|push.*gave numbers"):
        pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))


def test_a_force_that_ceases_to_be_finite_is_blamed(scenes):
    scene, upper = scenes.hinged()
    scene.add(Push(upper.section("right"), lambda t, x, v: np.zeros((1, 2)) if t < 5e-3 else np.full((1, 2), np.nan), name="push"))
    run = pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))
    assert not run.success and "'push'" in run.message and run.t[-1] < 6e-3


def test_parts_are_looked_at(scenes):
    class Bare(pi.ForceElement):
        pass

    scene, upper = scenes.hinged()
    with pytest.raises(pi.InputError, match="field `name"):
        scene.add(Bare())
    for side in (upper, pi.ground, 3.0, None):
        scene, upper = scenes.hinged()
        scene.add(Pull(upper.section("right"), side, name="pull"))
        with pytest.raises(pi.InputError, match="pull"):
            scene.build()
    scene, upper = scenes.hinged()
    scene.add(Pull(upper.section("right"), scenes.plate("other").section("left"), name="pull"))
    with pytest.raises(pi.InputError, match="not in the scene"):
        scene.build()
