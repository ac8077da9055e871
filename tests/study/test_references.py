"""References of the studies: independent runs against what is known, and the cases' own consistency."""

import numpy as np
import pytest

import digits
import polyida as pi
from polyida import problems, progress
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.model import Model
from polyida.problems import andrews, plates
from polyida.study import kept, references, refinement
from polyida.study.ivp import InitialValueProblem
from polyida.study.precision import unresolved_pulse_notes
from step_size_sensitivity.errors import smooth
from work_precision import cases

CLASSICAL = ("pendulum", "car-axis", "andrews")


def test_explicit_runs_meet_the_closed_solution_of_the_pendulum():
    p = problems.get("pendulum")
    q, v, _, lam = references.explicit(p.model, p.t_end, 1e-11, q0=p.q0, v0=p.v0)[0]
    assert np.abs(q - p.reference["q"]).max() < 1e-8 and np.abs(v - p.reference["v"]).max() < 1e-7
    assert np.abs(lam - p.reference["lam"]).max() < 1e-6


def test_explicit_runs_are_put_back_on_the_constraints_that_they_drift_off():
    p = problems.get("pendulum")
    off = [
        references.explicit(p.model, p.t_end, 1e-10, q0=p.q0, v0=p.v0, legs=legs)[0][0] - p.reference["q"] for legs in (1, references.LEGS)
    ]
    assert np.abs(off[1]).max() < 0.1 * np.abs(off[0]).max()


def test_three_families_agree_as_well_as_their_steps_allow():
    """On a smooth motion: extrapolated to fourth order, the distance falls by 16 as the steps are halved; Radau's follows rtol."""
    model = smooth("load", 4)
    exact = references.by_explicit(model, 0.05, 1e-11)
    coarse, fine = (references.distance(exact, references.extrapolated(model, 0.05, EnergyMomentum, h))["q"] for h in (2e-3, 1e-3))
    assert fine < coarse / 8 and fine < 1e-9
    loose, tight = (references.distance(exact, references.by_radau(model, 0.05, rtol))["q"] for rtol in (1e-10, 1e-12))
    assert tight < loose / 8 and tight < 1e-12


def test_radau_and_explicit_runs_agree_on_the_undamped_plates():
    given = cases.case("double-plate-motors", True).reference
    assert given["known_to"]["q"] < 1e-11 and given["known_to"]["v"] < 1e-7 and given["known_to"]["lam"] < 1e-5
    assert [how.split(",")[0] for how in given["made_by"]] == ["Radau IIA", "DOP853 on the index-1 equations"]


@pytest.mark.parametrize("name", CLASSICAL)
def test_radau_and_explicit_runs_agree_on_the_classical_problems(name):
    p, tolerances = problems.get(name), digits.CLASSICAL[name]
    ends = [
        family(p.model, 0.05 * p.t_end, rtol, p.q0, p.v0) for family, rtol in zip((references.by_explicit, references.by_radau), tolerances)
    ]
    assert references.distance(*ends)["q"] < 2e-12


@pytest.mark.parametrize("name", CLASSICAL)
def test_explicit_runs_come_as_near_as_the_digits_are_known(name):
    p = problems.get(name)
    end = digits.parts_of(p, p.t_end, references.by_explicit(p.model, p.t_end, digits.CLASSICAL[name].explicit, p.q0, p.v0))
    assert all(error < p.known_to[part] for part, error in p.errors(**{part: end[part] for part in p.reference}).items())


def test_printed_digits_of_andrews_are_farther_off_than_what_is_known():
    p = problems.get("andrews")
    for part, error in p.errors(**andrews.PRINTED).items():
        assert 100 * p.known_to[part] < error < 1e-6 * np.abs(p.reference[part]).max()


def pair_of(apart):
    """A family that is so far from Radau IIA in every part, level by level."""
    asked = []

    def other(ivp, level):
        asked.append(level)
        return f"other {level}", {part: value + apart[level] for part, value in refinement._by_radau_at(ivp, level)[1].items()}

    return asked, other


def swing():
    p = problems.get("pendulum")
    return InitialValueProblem("pendulum", p.model, 0.2, p.q0, p.v0)


def test_a_reference_is_known_as_well_as_an_unlike_method_agrees():
    """Not as well as it agrees with itself: what both runs of one family share is seen."""
    asked, other = pair_of((1e-3,) * 4)
    found = refinement.make_reference(swing(), others=(other,))
    assert found["known_to"] == {part: pytest.approx(1e-3) for part in refinement.PARTS} and asked == [1, 2]  # no nearer: no further level
    assert np.array_equal(found["q"], refinement._by_radau_at(swing(), 1)[1]["q"]) and [how[:5] for how in found["made_by"]] == [
        "Radau",
        "other",
    ]


def test_a_reference_is_refined_until_it_is_known_to_a_tenth_of_what_is_measured():
    asked, other = pair_of((1.0, 1e-3, 1e-5, 1e-7))
    found = refinement.make_reference(swing(), lambda values: dict.fromkeys(refinement.PARTS, 2e-4), others=(other,))
    assert asked == [1, 2] and found["known_to"]["q"] == pytest.approx(1e-5)


def test_what_two_methods_share_is_seen_by_how_far_a_finer_run_moves():
    """A family that errs as Radau IIA does agrees with it to round-off: behind the end of a linear load, of another slope of lam too."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    scene.add(pi.PointLoad(bar.at("right"), (3.0, 5.0), pi.profile.linear(0.0, 1.0, 0.1), name="load"))
    motion = InitialValueProblem("kink", scene.build(), 0.1001)
    found = refinement.make_reference(motion, lambda values: dict.fromkeys(refinement.PARTS, 1e-3), others=(refinement._by_radau_at,))
    off = references.distance(found, references.by_explicit(motion.model, motion.t_end, 2.3e-14))
    assert all(off[part] <= found["known_to"][part] for part in off) and found["known_to"]["q"] < 1e-9


def test_another_family_is_asked_where_one_does_not_come_there_or_near():
    def broken(ivp, level):
        raise RuntimeError("it broke")

    (_, far), (_, near) = pair_of((1e-3,) * 4), pair_of((1e-6,) * 4)
    found = refinement.make_reference(swing(), lambda values: dict.fromkeys(refinement.PARTS, 1e-4), others=(broken, far, near))
    assert found["known_to"]["q"] == pytest.approx(1e-6, rel=1e-3) and found["failed"] == ["it broke"]
    nothing = refinement.make_reference(swing(), others=(broken,))
    assert nothing.keys() == {"failed", "cpu_s"} and nothing["failed"] == ["it broke"]


def test_a_stiff_reference_shares_no_family_with_its_judge():
    given = cases.by_two("pair", smooth("load", 4), 0.02, refinement.BY_ENERGY_MOMENTUM).reference
    off = references.distance(given, references.by_explicit(smooth("load", 4), 0.02, 1e-11))
    assert all(off[part] <= 1.5 * given["known_to"][part] for part in off) and given["made_by"][1].startswith("energy-momentum")


def test_explicit_runs_that_would_take_too_long_are_not_made():
    model = plates.double_plate(cells=4, material=plates.Material(E=2e14, nu=0.3, rho=1000.0)).build()
    with pytest.raises(references.TooStiff, match="evaluations, for the motion is stiff"):
        references.by_explicit(model, 1.0, 1e-9, limited=True)


class RunsAway(Model):
    """q'' = 6 q^2: from q = 1, q' = 2, q = 1/(1 - t)^2 has no end at t = 1 s."""

    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return -6 * q**2


class Bump(Model):
    """1 kg at 1 m/s that is pushed back over 1 mm: by 600 N it is turned, by 200 N it passes and is the slower."""

    n, m = 1, 0

    def __init__(self, push):
        self.push = push

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        s = (q - 0.5) / 1e-3
        return self.push * np.where(np.abs(s) < 1, (1 - s**2) ** 2, 0.0)


@pytest.mark.parametrize("push", [200.0, 600.0])
def test_a_force_that_both_methods_step_over_is_not_known(push):
    """They agree to round-off; the energy says where it ends."""
    motion = InitialValueProblem("bump", Bump(push), 1.0, [0.0], [1.0])
    found = refinement.make_reference(motion)
    work = push * 1e-3 * 16 / 15
    gap = abs(found["v"][0] - (np.sqrt(1.0 - 2.0 * work) if work < 0.5 else -1.0))
    assert gap <= found["known_to"]["v"] and found["sampling"] == pytest.approx(1.0 / 4000)
    assert "can miss a force" in unresolved_pulse_notes(found)[0]


def test_a_contact_is_known_as_well_as_two_methods_agree():
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, velocity=(1.0, 0.0)))
    scene.add(pi.PenaltyContact(pi.ground.at((0.5, 0.0)), body.at("c"), stiffness=1e6, radius=0.01, exponent=1.5))
    model = scene.build()
    found = refinement.make_reference(InitialValueProblem("contact", model, 1.0), others=(refinement.BY_BDF,))
    assert abs(found["v"][0] + 1.0) <= found["known_to"]["v"]


def test_a_reference_run_that_stops_is_no_reference():
    assert references.by_radau(RunsAway(), 0.5, 1e-10, [1.0], [2.0])["q"] == pytest.approx([4.0], rel=1e-7)
    with pytest.raises(RuntimeError, match=r"reference by RadauIIA\(rtol=1e-06"):
        references.by_radau(RunsAway(), 1.5, 1e-6, [1.0], [2.0])


def turning_bar():
    """A scene whose forces announce all discontinuities."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left")))
    return scene.build()


def counted_runs(monkeypatch):
    """The integrators of the reference runs that are made from now on."""
    made, run = [], references.full_run

    def counted(model, t_end, integrator, *more, **options):
        made.append(integrator)
        return run(model, t_end, integrator, *more, **options)

    for module in (references, refinement):
        monkeypatch.setattr(module, "full_run", counted)
    return made


def steps_of(model, **options):
    return pi.study.step_sizes(model, 0.1, integrators={"alpha": pi.GeneralizedAlpha}, h=(4e-3, 2e-3), **options)


def test_a_reference_is_as_accurate_as_the_study_needs_by_two_orders_of_one_method(monkeypatch):
    """No run of BDF, and none finer than a tenth of the smallest error asks for."""
    made = counted_runs(monkeypatch)
    monkeypatch.setattr(kept, "_in_memory", {})
    study = steps_of(turning_bar())
    exact = references.by_explicit(turning_bar(), 0.1, 2.3e-14)
    off = references.distance({part: study.reference[part] for part in refinement.PARTS}, exact)
    assert all(off[part] <= study.known_to[part] <= 0.1 * study.rows[1][f"error_{part}"] for part in off)
    assert {type(one) for one in made} == {pi.RadauIIA} and min(one.rtol for one in made) >= 1e-9
    assert [text.partition(",")[0] for text in study.reference["made_by"]] == ["Radau IIA", "Radau IIA of order 3"]


def test_the_next_study_of_the_same_motion_takes_the_reference_that_is_known(monkeypatch, tmp_path):
    """From memory, and in a later process from the folder; another start or time has its own."""
    made = counted_runs(monkeypatch)
    monkeypatch.setattr(kept, "_in_memory", {})
    first = steps_of(turning_bar(), reference_folder=tmp_path)
    count = len(made)
    again = steps_of(turning_bar())
    assert (
        count > 0 and len(made) == count and np.array_equal(again.reference["q"], first.reference["q"]) and again.reference["cpu_s"] == 0.0
    )
    monkeypatch.setattr(kept, "_in_memory", {})
    later = steps_of(turning_bar(), reference_folder=tmp_path)
    assert len(made) == count and later.known_to == first.known_to and later.rows[0]["error_q"] == first.rows[0]["error_q"]
    steps_of(turning_bar(), q0=np.zeros(4), reference_folder=tmp_path)
    assert len(made) > count and len(list(tmp_path.iterdir())) == 2


def test_a_damaged_file_of_references_is_made_again(monkeypatch, tmp_path):
    made = counted_runs(monkeypatch)
    for text in ("{", '{"radau 0": {"unknown": 1}}', "[]"):
        monkeypatch.setattr(kept, "_in_memory", {})
        steps_of(turning_bar(), reference_folder=tmp_path)
        count, (file,) = len(made), tmp_path.iterdir()
        file.write_text(text)
        monkeypatch.setattr(kept, "_in_memory", {})
        steps_of(turning_bar(), reference_folder=tmp_path)
        assert len(made) > count


def test_progress_is_shown_where_someone_looks_on(monkeypatch, capsys):
    steps_of(turning_bar())
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "watched", lambda: True)
    steps_of(turning_bar(), progress=False)
    assert capsys.readouterr().err == ""
    steps_of(turning_bar())
    assert "step_sizes" in capsys.readouterr().err


def test_the_cost_of_the_next_reference_run_is_told_before_it(monkeypatch):
    monkeypatch.setattr(kept, "_in_memory", {})
    told = []
    steps_of(turning_bar(), progress=lambda done, total, text: told.append(text))
    references_told = [text for text in told if text.startswith("reference")]
    assert all("CPU s" in text for text in references_told[2:]) and len(references_told) >= 3


def test_a_folder_of_references_that_can_be_none_is_refused_before_the_runs(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    for wrong in (tmp_path / "file", 3):
        with pytest.raises(pi.InputError, match="step_sizes: reference_folder = "):
            steps_of(turning_bar(), reference_folder=wrong)
