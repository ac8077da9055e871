"""The plates against their digits at 1 s: a run of moderate accuracy, the default meshes, other meshes."""

import pytest

from polyida import problems
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.run.solve import solve

PLATES = ("double-plate", "double-plate-motors", "plate-chain")


@pytest.mark.parametrize("name", PLATES)
def test_a_run_of_moderate_accuracy_meets_the_digits(name):
    p = problems.get(name)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=1e-4), every=10**9)
    errors = p.compare(run)
    assert errors["tip"] < 1e-6 and errors["tip_velocity"] < 1e-3 and errors["lam"] < 0.3, errors


@pytest.mark.parametrize("name", PLATES)
def test_the_digits_are_of_one_state(name):
    """How well each is known is said, and better than what is compared with them."""
    p = problems.get(name)
    assert set(p.reference) == set(p.known_to) == set(p.measures) | {"lam"}
    shapes = {part: value.shape for part, value in p.reference.items()}
    assert shapes == {"tip": (2,), "tip_velocity": (2,), "lam": (p.model.m,)}
    assert p.known_to["tip"] < 1e-11 and p.known_to["tip_velocity"] < 1e-9 and p.known_to["lam"] < 1e-3
