"""Order of generalized-alpha and of its relatives: q, v and lam from the first step on, across kinks, extrapolated,
stabilised.
"""

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.alpha.generalized_alpha import Coefficients

START = dict(q0=[-1.0, 0.0], v0=[0.0, -3.0])
FIELDS = ("q", "v", "lam")


def bending(scenes):
    """A clamped plate, bent by a tip load that grows smoothly over 0.25 s."""
    scene, upper = scenes.cantilever()
    scene.add(pi.PointLoad(upper.section("right"), (0.0, -8.0), pi.profile.ramp(0.0, 1.0, duration=0.25), name="push"))
    return scene.build()


def orders(scenes, model, end, counts, finest, reference=None, fields=FIELDS, **settings):
    """{field: fitted order of the largest deviation over all times from a run with `finest` steps}."""
    start = settings.pop("begin", {})
    solve = lambda n, **more: pi.solve(model, end, pi.GeneralizedAlpha(h=end / n, **(settings | more)), **start)  # noqa: E731
    exact = solve(finest, **(reference or {}))
    errors = {name: [] for name in fields}
    for n in counts:
        run = solve(n)
        assert run.success, run.message
        for name in fields:
            errors[name].append(np.abs(getattr(run, name) - getattr(exact, name)[:: finest // n]).max())
    return {name: scenes.slope([end / n for n in counts], column) for name, column in errors.items()}


def turning(scenes):
    """A plate, turned by a motor at its hinge."""
    scene, upper = scenes.hinged((0.0, 0.0))
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=pi.profile.ramp(0.0, 0.5, duration=0.3), name="drive"))
    return scene.build()


@pytest.mark.parametrize(
    "make, settings", [(turning, {}), (bending, {}), (bending, {"rho_inf": 0.5}), (bending, {"rho_inf": 0.0}), (bending, {"linear": "kkt"})]
)
def test_second_order_of_smooth_motions(scenes, make, settings):
    """From the first step on."""
    found = orders(scenes, make(scenes), 0.3, (60, 120, 240), 960, tolerance=1e-6, **settings)
    assert found == pytest.approx(dict.fromkeys(FIELDS, 2.0), abs=0.1)


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_stabilised_form(scenes, linear):
    """Second order, phi and the velocity constraint to round-off at every step."""
    model, end = turning(scenes), 0.3
    found = orders(scenes, model, end, (30, 60, 120), 480, {"linear": "auto"}, tolerance=1e-6, form="stabilised", linear=linear)
    assert found == pytest.approx(dict.fromkeys(FIELDS, 2.0), abs=0.1)
    runs = [
        pi.solve(model, end, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-7, form=form, linear=linear)) for form in ("index3", "stabilised")
    ]
    assert runs[0].velocity_drift.max() > 1e-6
    assert runs[1].velocity_drift.max() < 1e-12 and runs[1].drift.max() < 1e-11


@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_a_model_of_ones_own(scenes, form):
    model = pi.problems.get("pendulum").model
    found = orders(scenes, model, 0.5, (50, 100, 200), 1600, {"tolerance": 1e-7}, tolerance=1e-9, form=form, begin=START)
    assert found == pytest.approx(dict.fromkeys(FIELDS, 2.0), abs=0.1)


MEMBERS = {
    "hht": (lambda h, **more: pi.GeneralizedAlpha.hht(h, -0.1, **more), 2.0),
    "wbz": (lambda h, **more: pi.GeneralizedAlpha.wbz(h, -0.2, **more), 2.0),
    "newmark": (lambda h, **more: pi.GeneralizedAlpha.newmark(h, 0.3025, 0.6, **more), 1.0),
}


@pytest.fixture(scope="module")
def swung():
    """A pendulum's run far more exact than those of the members."""
    model = pi.problems.get("pendulum").model
    return pi.solve(model, 0.5, pi.GeneralizedAlpha(h=0.5 / 1600, tolerance=1e-7, extrapolate=True), **START)


@pytest.mark.parametrize("name", MEMBERS)
def test_other_members(scenes, swung, name):
    make, order = MEMBERS[name]
    steps = [0.5 / n for n in (50, 100, 200)]
    runs = [pi.solve(swung.model, 0.5, make(h, tolerance=1e-9), **START) for h in steps]
    assert scenes.slope(steps, [np.abs(run.q[-1] - swung.q[-1]).max() for run in runs]) == pytest.approx(order, abs=0.1)
    compiled, plain = (pi.solve(bending(scenes), 0.05, make(1e-3, tolerance=1e-7, linear=linear)) for linear in ("auto", "kkt"))
    assert np.abs(compiled.q - plain.q).max() < 1e-9


@pytest.mark.parametrize("rho_inf", [0.0, 0.3, 0.9])
def test_spectral_radius_at_infinity(rho_inf):
    assert Coefficients.chung_hulbert(rho_inf).at_infinity == pytest.approx(rho_inf, abs=1e-6)
    c = Coefficients.chung_hulbert(rho_inf)
    assert Coefficients.second_order(c.alpha_m, c.alpha_f) == c


def test_extrapolation_stops_where_its_runs_have_parted(scenes):
    """Plates that swing for seconds on steps of 20 ms are sensitive to everything."""
    scene = scenes.jointed("revolute")
    run = pi.solve(scene.build(), 20.0, pi.GeneralizedAlpha(h=2e-2, extrapolate=True))
    assert run.status == "extrapolation" and "apart in q" in run.message and len(run) > 10
    strain = run.energy.strain
    assert strain.max() < 10 * pi.solve(scene.build(), run.t[-1], pi.GeneralizedAlpha(h=1e-2)).energy.strain.max()


def test_extrapolation_is_of_higher_order_and_cheaper(scenes):
    """On a smooth ramp, at the ends of the steps; fewer solves for a tenth of the error."""
    model, end = bending(scenes), 0.3
    found = orders(scenes, model, end, (30, 60, 120), 960, tolerance=1e-7, extrapolate=True)
    assert min(found.values()) > 3.0
    exact = pi.solve(model, end, pi.GeneralizedAlpha(h=end / 960, tolerance=1e-7, extrapolate=True))
    plain, better = (
        pi.solve(model, end, pi.GeneralizedAlpha(h=end / n, extrapolate=extrapolate)) for n, extrapolate in ((480, False), (60, True))
    )
    assert better.counts.steps == 60 and better.counts.newton_iterations < plain.counts.newton_iterations
    assert np.abs(better.q[-1] - exact.q[-1]).max() < 0.3 * np.abs(plain.q[-1] - exact.q[-1]).max()


class Kinked(pi.Model):
    """A pendulum of length 1 m and mass 1 kg, pushed by a force that grows linearly within `over`, from 0.1 s on."""

    n, m, needs = 2, 1, pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def __init__(self, over):
        self.over = over

    def kinks(self, t0, t1):
        return tuple(t for t in sorted({0.1, 0.1 + self.over}) if t0 < t < t1)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        push = float(t > 0.1) if self.over == 0 else np.clip((t - 0.1) / self.over, 0.0, 1.0)
        return np.array([-30.0 * push, 9.81])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2 * q[None]


@pytest.mark.parametrize("over", [0.2, 0.0], ids=["a kink of a load", "a jump of a load"])
def test_second_order_across_kinks(scenes, over):
    """q''' and q'' jump there, and with them what the method carries; a load that jumps has two values at that time,
    so lam is left out.
    """
    fields = FIELDS if over else ("q", "v")
    found = orders(scenes, Kinked(over), 0.4, (40, 80, 160), 1280, tolerance=1e-9, begin=START, fields=fields)
    assert found == pytest.approx(dict.fromkeys(fields, 2.0), abs=0.15)
