"""Viscoelastic reduced plates against the full plate and identities; small motions of viscoelastic plates about a state."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

import polyida as pi

TERMS = [(0.4, 0.05), (0.2, 0.3)]


def arm(kind="virtual", terms=TERMS, joint=pi.Clamp, E=2e6, **reduction):
    """A viscoelastic arm under gravity with a mass at its end, reduced if `reduction` says how."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    material = pi.Material(E=E, nu=0.3, rho=1000.0, prony=terms)
    plate = pi.Plate(pi.mesh.quads(0.4, 0.1, 4, 2), material, 0.01, element=kind, name="arm")
    body = scene.add(pi.Reduced(plate, **reduction) if reduction else plate)
    scene.add(joint(body.section("left"), pi.ground, name="foot"))
    scene.add(pi.PointMass(body.section("right"), 0.2, name="tip"))
    return scene.build()


@pytest.fixture(scope="module")
def swing():
    """The full arm as a pendulum."""
    return pi.solve(arm(joint=pi.Revolute), 0.3, pi.GeneralizedAlpha(h=2e-3))


@pytest.fixture(scope="module")
def reduced(swing):
    """The same in the fields of this run."""
    return arm(joint=pi.Revolute, modes=0, fields=pi.pod_modes(swing, "arm", 6))


def test_in_its_fields_a_reduced_plate_moves_and_relaxes_as_the_full_one(swing, reduced):
    run = pi.solve(reduced, 0.3, pi.GeneralizedAlpha(h=2e-3))
    assert np.abs(run.position("tip") - swing.position("tip")).max() < 2e-6
    assert np.abs(run.stress(-1) - swing.stress(-1)).max() < 1e-2 * np.abs(swing.stress(-1)).max()
    assert run.energy.dissipated["arm"][-1] == pytest.approx(swing.energy.dissipated["arm"][-1], rel=1e-4)
    assert run.energy.strain[-1] == pytest.approx(swing.energy.strain[-1], rel=1e-4)


@pytest.mark.parametrize(
    "integrator, tolerance", [(pi.IDA(rtol=1e-8), 2e-6), (pi.EnergyMomentum(h=1e-3), 2e-5), (pi.RadauIIA(rtol=1e-6), 2e-6)]
)
def test_all_integrators_agree(reduced, integrator, tolerance):
    tight = pi.solve(reduced, 0.1, pi.RadauIIA(h=2e-3))
    run = pi.solve(reduced, 0.1, integrator)
    assert np.abs(run.position("tip")[-1] - tight.position("tip")[-1]).max() < tolerance
    assert np.abs(run.x[-1] - tight.x[-1]).max() < tolerance * np.abs(tight.x).max() * 1e2


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(rtol=1e-4), pi.IDA(rtol=1e-4), pi.RadauIIA(rtol=1e-4)])
def test_steps_do_not_depend_on_the_unit_of_length(integrator):
    """The strains of a reduced plate are products of lengths; their tolerance is relative to these. 1024 is exact in binary numbers."""

    def steps(unit):
        scene = pi.Scene(gravity=(0.0, -8.0 * unit))
        material = pi.Material(E=2e6 / unit, nu=0.25, rho=1000.0 / unit**3, prony=TERMS)
        mesh = pi.mesh.quads(0.5 * unit, 0.125 * unit, 4, 2)
        body = scene.add(pi.Reduced(pi.Plate(mesh, material, unit / 64, name="arm"), modes=3))
        scene.add(pi.Revolute(body.section("left"), pi.ground, name="foot"))
        return pi.solve(scene.build(), 0.125, integrator).counts.steps

    assert steps(1024.0) == steps(1.0)


def test_energy_and_dissipated_work_in_the_energy_momentum_method(reduced):
    run, h, dissipated = pi.solve(reduced, 0.1, pi.EnergyMomentum(h=2e-3)), 2e-3, 0.0
    placed, strains, size = reduced.reduced_bodies[0], reduced.strains["arm"], len(reduced.reduced_bodies[0].form[1])
    for (q0, v0), (q1, v1) in pairwise(zip(np.asarray(run.q), np.asarray(run.v))):
        ends = []
        for q in (q0, q1):
            z = placed.rest[1:] + q.reshape(-1, 2)[placed.pairs][1:] @ (1, 1j)
            products = z.conj()[:, None] * z
            ends.append(np.r_[products[np.triu_indices(len(z))].real, products[np.triu_indices(len(z), 1)].imag])
        mean = 0.5 * (ends[0] + ends[1]) - np.eye(size)[0] * abs(placed.rest[1]) ** 2
        x = (strains.units * 0.5 * (v0 + v1)[strains.columns]).reshape(len(TERMS), -1)
        dissipated += h * sum(g / tau * (mean - one) @ placed.form[0] @ (mean - one) for (g, tau), one in zip(TERMS, x))
    energy = run.energy.total
    assert dissipated > 1e-2 * run.energy.strain.max()
    assert abs(energy[-1] + dissipated - energy[0]) < 1e-9 * np.abs(energy).max()


def test_statics_take_the_long_time_modulus_and_runs_stay_there():
    loaded, soft = arm(modes=4), arm("wachspress", modes=4)
    rest = pi.static(loaded)
    run = pi.solve(loaded, 0.1, pi.GeneralizedAlpha(h=2e-3), state=rest)
    assert np.abs(run.position("tip") - run.position("tip")[0]).max() < 1e-10
    elastic = pi.static(arm("wachspress", terms=(), E=0.4 * 2e6, modes=4))
    rest = pi.static(soft)
    assert np.abs(soft.nodal(rest.q) - elastic.model.nodal(elastic.q)).max() < 1e-8
    long_time = 0.4 * soft.stress(rest.q)  # of the modulus of a sudden strain
    assert soft.stress(rest.q, rest.v) == pytest.approx(long_time, rel=1e-9, abs=1e-9 * np.abs(long_time).max())


@dataclass(frozen=True, eq=False)
class Spring(pi.Body):
    """Two masses at (0, 0) and (1, 0) whose distance |z| has the energy (|z|^2 - 1)^2 / 2 and relaxes by `terms`."""

    terms: tuple
    name: str | None = None

    def coordinates(self):
        return [0.0, 1.0]

    def mass_matrix(self):
        return np.eye(2)

    def attachments(self):
        return {"a": [1.0, 0.0], "b": [1.0, 1.0]}

    def form(self):
        return np.eye(1), np.zeros(1)

    def prony(self):
        return self.terms


def test_an_own_body_relaxes_by_its_series():
    scene = pi.Scene(gravity=(0.0, 0.0))
    body = scene.add(Spring(((0.5, 0.1),)))
    scene.add(pi.PointLoad(body.at("b"), (1e-6, 0.0)))
    model = scene.build()
    run = pi.solve(model, 1.0, pi.RadauIIA(h=0.01))
    stretch, relaxed = np.abs(1.0 + run.q[:, 2]) - 1.0, run.x[:, 0]  # y - y_0 is twice the stretch
    f = model.force(0.0, run.q[-1], run.v[-1])[:4]
    assert model.k == 1 and 0.0 < relaxed[-1] < 2.0 * stretch[-1]
    assert f[2] == pytest.approx(2.0 * (2.0 * stretch[-1] - 0.5 * relaxed[-1]) - 1e-6, rel=1e-4)
    wrong = pi.Scene()
    wrong.add(Spring(((1.5, 0.1),), name="loose"))
    with pytest.raises(pi.InputError, match="'loose'.*prony"):
        wrong.build()


@pytest.mark.parametrize("c", [3e2, 2e2 + 3e2j])
def test_strains_are_eliminated_from_the_step_matrix(c):
    model, rng = arm(modes=2), np.random.default_rng(0)  # (modes + 1)^2 = 9 states of a term, with one that is not used
    first = 2 * model.n_factored
    q, v, r, lam = 1e-3 * rng.standard_normal(model.n), rng.standard_normal(model.n), rng.standard_normal(model.n), np.zeros(model.m)
    v[:first] = 0.0
    step = model.step_matrix()
    step.factor(0.0, q, v, v, lam, c * c, c)
    S, B = model.tangent(0.0, q, v, v, lam, c * c, c, 1.0).toarray(), model.phi_q(0.0, q).toarray()
    exact = np.linalg.solve(np.block([[S, B.T], [B, np.zeros((model.m,) * 2)]]), -np.r_[r, lam])[: model.n]
    found = step.saddle(0.0, q, lam, r, lam)[0]
    assert model.k == 18 and model.n == first + 20
    for part in (slice(first), slice(first, None)):  # the factor has single precision
        assert np.abs(found - exact)[part].max() < 1e-4 * np.abs(exact[part]).max()


def test_slopes_are_those_of_the_forces():
    model, rng = arm(modes=2), np.random.default_rng(0)
    q, v, d = 1e-3 * rng.standard_normal(model.n), rng.standard_normal(model.n), rng.standard_normal(model.n)
    along_q = (model.force(0.0, q + 1e-7 * d, v) - model.force(0.0, q - 1e-7 * d, v)) / 2e-7
    along_v = (model.force(0.0, q, v + 1e-3 * d) - model.force(0.0, q, v - 1e-3 * d)) / 2e-3
    assert model.force_q(0.0, q, v) @ d == pytest.approx(along_q, rel=1e-6, abs=1e-6 * np.abs(along_q).max())
    assert model.force_v(0.0, q, v) @ d == pytest.approx(along_v, rel=1e-6, abs=1e-8 * np.abs(along_v).max())


@pytest.mark.parametrize("reduction", [{}, {"modes": 3}])
def test_damped_modes_have_the_complex_modulus(reduction):
    model = arm("wachspress", **reduction)
    modes = pi.modes(model, count=1000, damped=True)
    elastic = pi.modes(model, count=1000)
    plain, none = elastic.model, np.zeros(elastic.model.n)
    M, K, B = (x.toarray() for x in (plain.mass(), plain.force_q(0.0, none, none), plain.phi_q(0.0, none)))
    free = np.linalg.svd(B)[2][np.linalg.matrix_rank(B) :]
    for s, x in zip(modes.roots, modes.shapes):
        kappa = 1.0 - sum(g / (1.0 + s * tau) for g, tau in TERMS)
        terms = free @ (s**2 * (M @ x)), free @ (kappa * (K @ x))
        assert np.abs(terms[0] + terms[1]).max() < 1e-7 * np.abs(terms[0]).max() + 1e-9 * np.abs(K @ x).max()
    assert len(modes.roots) == len(free) * (1 + len(TERMS))


@pytest.mark.parametrize("reduction", [{}, {"modes": 4}])
def test_the_state_space_has_the_response_and_the_roots(reduction):
    model = arm(**reduction)
    rest, frequencies = pi.static(model), np.array([0.3, 1.0, 2.6, 8.0])
    push = np.zeros(model.n)
    push[5 if reduction else 27] = 1.0
    system = pi.linearise(model, rest, inputs=push, outputs=["tip", ("tip", "velocity")])
    whole = pi.frequency_response(model, rest, push, ["tip", ("tip", "velocity")], frequencies).values
    assert system.response(frequencies)[:, :, 0] == pytest.approx(whole, rel=1e-8)
    assert len(system.states) == len(TERMS) * (len(system.A) - len(system.states)) / 2
    roots = pi.modes(model, rest, count=1000, damped=True).roots
    poles = np.linalg.eigvals(system.A)
    assert max(np.abs(poles - s).min() for s in roots) < 1e-7 * np.abs(poles).max() and poles.real.max() < 0.0
    few = pi.linearise(model, rest, inputs=push, outputs="tip", modes=3)
    assert len(few.A) == 3 * (2 + len(TERMS))
    some = pi.frequency_response(model, rest, push, "tip", frequencies, modes=3).values
    assert few.response(frequencies)[:, :, 0] == pytest.approx(some, rel=1e-8)


def test_files_keep_reduced_viscoelastic_plates(tmp_path):
    run = pi.solve(arm(modes=2), 0.02, pi.GeneralizedAlpha(h=2e-3))
    run.save(tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5")
    assert np.array_equal(again.x, run.x) and again.model.reduced_bodies[0].prony == tuple(TERMS)
    assert again.stress(-1) == pytest.approx(run.stress(-1), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("reduction", [{}, {"modes": 3}])
def test_the_response_at_zero_frequency_is_the_static_deflection(reduction):
    """With the long-time modulus, although the integrals of the relaxed strains, which are coordinates, grow without bound."""
    scene = pi.Scene()
    plate = pi.Plate(pi.mesh.quads(0.4, 0.1, 4, 2), pi.Material(E=2e6, nu=0.3, rho=1000.0, prony=TERMS), 0.01, name="arm")
    body = scene.add(pi.Reduced(plate, **reduction) if reduction else plate)
    scene.add(pi.Weld(body.section("left"), pi.ground, name="foot"))
    scene.add(pi.PointLoad(body.section("right"), (0.0, 1.0), pi.profile.constant(1.0), name="tip"))
    model = scene.build()
    rest = pi.static(model, linear=True)
    moved = np.ptp(model.position("tip", np.stack([0.0 * rest.q, rest.q])), axis=0)
    assert pi.frequency_response(model, None, "tip", "tip", 0.0).values[0] == pytest.approx(moved, rel=1e-9, abs=1e-12)
