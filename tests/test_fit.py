"""Parameters from measured values: `pi.fit`."""

import numpy as np
import pytest

import polyida as pi

TIMES = np.linspace(0.0, 1.0, 41)


def swing(stiffness=40.0, damping=0.8):
    """Places of a mass on a spring and a damper."""
    scene = pi.Scene()
    mass = scene.add(pi.RigidBody(1.0, 1.0, {"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="mass"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (1.0, 0.0)), mass.at("c"), name="rail"))
    scene.add(pi.SpringDamper(pi.ground.at((-1.0, 0.0)), mass.at("c"), stiffness, damping, name="spring"))
    return pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=1e-2), output=TIMES).position("rail")[:, 0]


def decay(rate, size=1.0):
    return size * np.exp(-rate * TIMES)


def test_data_without_noise_give_the_parameters_of_a_run_back():
    found = pi.fit(swing, swing(), {"stiffness": 55.0, "damping": 0.3}, bounds={"damping": (0.0, np.inf)})
    assert found.values["stiffness"] == pytest.approx(40.0, rel=1e-6)
    assert found.values["damping"] == pytest.approx(0.8, rel=1e-6)
    assert found.runs < 60 and found.failed == 0


def test_covariance_is_that_of_linear_least_squares():
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(TIMES))
    found = pi.fit(lambda a, b: a + b * TIMES, 2.0 + 3.0 * TIMES + noise, {"a": 1.0, "b": 1.0})
    exact, covariance = np.polyfit(TIMES, 2.0 + 3.0 * TIMES + noise, 1, cov="unscaled")
    assert [found.values["b"], found.values["a"]] == pytest.approx(exact, rel=1e-8)
    left = found.predicted - found.measured
    expected = covariance[::-1, ::-1] * (left @ left) / (len(TIMES) - 2)
    assert found.covariance == pytest.approx(expected, rel=1e-4)
    assert found.correlation[0, 1] == pytest.approx(expected[0, 1] / np.sqrt(expected[0, 0] * expected[1, 1]), rel=1e-4)
    known = pi.fit(lambda a, b: a + b * TIMES, 2.0 + 3.0 * TIMES + noise, {"a": 1.0, "b": 1.0}, sigma=1e-3)
    assert known.covariance == pytest.approx(1e-6 * covariance[::-1, ::-1], rel=1e-4)
    assert "a = " in found.summary() and len(found.plot().axes[0].lines) == 2


@pytest.mark.parametrize("failure", ["raises", "nan", "short"])
def test_a_run_that_fails_is_a_large_residual(failure):
    def fragile(rate):
        if rate < 0.5:
            if failure == "raises":
                raise pi.StepFailure("newton", "no convergence")
            return np.full(41, np.nan) if failure == "nan" else decay(rate)[:3]
        return decay(rate)

    found = pi.fit(fragile, decay(0.6), {"rate": 5.0})
    assert found.values["rate"] == pytest.approx(0.6, rel=1e-6)
    assert found.failed > 0


def test_parameters_that_cannot_be_told_apart():
    with pytest.warns(UserWarning, match="do not determine all parameters"):
        pi.fit(lambda a, b: (a + b) * TIMES, 3.0 * TIMES, {"a": 1.0, "b": 1.0})


WRONG = {
    "no function": (dict(function=3.0), "function = 3.0 must take"),
    "other parameters": (dict(start={"pace": 1.0}), "does not take the parameters pace as keywords"),
    "text": (dict(measured="text"), "measured = .* must be finite numbers"),
    "too few values": (dict(measured=[1.0], start={"rate": 1.0, "size": 1.0}), "at least as many as the 2 parameters"),
    "a list": (dict(start=[1.0]), "must be a dictionary of the parameters"),
    "an unknown bound": (dict(bounds={"speed": (0.0, 1.0)}), "bounds = .* of parameters: rate"),
    "bounds the wrong way": (dict(bounds={"rate": (2.0, 0.0)}), "the least value first"),
    "a start out of bounds": (dict(bounds={"rate": (2.0, 3.0)}), "does not start within its bounds"),
    "another shape": (dict(function=lambda rate: 1.0), r"finite numbers of the shape \(41,\) at the start"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_refused(case):
    changed, words = WRONG[case]
    given = {"function": decay, "measured": decay(1.0), "start": {"rate": 1.0}} | changed
    with pytest.raises(pi.InputError, match=words):
        pi.fit(**given)
