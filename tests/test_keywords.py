"""A keyword that a public function or class does not have: the answer names those that it has. Signatures stay as they are."""

import inspect
import pickle

import pytest

import polyida as pi
from polyida.study.precision import StepSizes, WorkPrecision
from polyida.validation import KeywordError, named_keywords

NOT_CALLED = {
    "Model",
    "Integrator",
    "Joint",
    "ForceElement",
    "Controller",
    "Body",
    "Trajectory",
    "Events",
    "InputError",
    "StepFailure",
    "SingularSystem",
    "StepMatrix",
    "LockingWarning",
    "ReductionWarning",
    "ground",
}  # to be derived from, or handed out
EACH_STEP = {"State", "Counts"}  # made in the loops of integrators
PUBLIC = {f"pi.{name}": getattr(pi, name) for name in sorted({*pi.__all__} - NOT_CALLED - EACH_STEP) if callable(getattr(pi, name))}
NO_CALLS = ("FORMATS", "Domain", "MeshQuality", "MeshWarning", "Section")
PUBLIC |= {f"pi.mesh.{name}": getattr(pi.mesh, name) for name in pi.mesh.__all__ if name not in NO_CALLS}
PUBLIC |= {
    f"pi.profile.{name}": getattr(pi.profile, name)
    for name in ("constant", "polynomial", "quintic", "ramp", "linear", "sine", "from_function")
}
PUBLIC |= {f"pi.design.{name}": getattr(pi.design, name) for name in pi.design.__all__}
PUBLIC |= {f"pi.sensor.{name}": getattr(pi.sensor, name) for name in pi.sensor.__all__}
PUBLIC |= {f"pi.objective.{name}": getattr(pi.objective, name) for name in pi.objective.__all__ if name != "Objective"}
PUBLIC |= {"pi.export.vtu": pi.export.vtu, "pi.study.sweep": pi.study.sweep}


@pytest.mark.parametrize("name", PUBLIC)
def test_all_that_it_takes_is_named(name):
    with pytest.raises(KeywordError, match="there is no argument 'nonsense'; .*it takes") as raised:
        PUBLIC[name](nonsense=1)
    told = str(raised.value)
    assert len(told) > 500 or all(word in told for word in inspect.signature(PUBLIC[name]).parameters)


METHODS = [
    WorkPrecision.plot,
    StepSizes.plot,
    pi.study.Result.to_latex,
    pi.study.Result.report,
    pi.Trajectory.animate,
    pi.Trajectory.save,
    pi.Scene.plot,
]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__qualname__)
def test_all_that_a_method_takes_is_named(method):
    names = [name for name in inspect.signature(method).parameters if name != "self"]
    with pytest.raises(KeywordError) as raised:
        method(None, nonsense=1)
    assert str(raised.value) == f"{method.__name__}: there is no argument 'nonsense'; it takes {', '.join(names)}"


@pytest.mark.parametrize(
    "call, meant",
    [
        (lambda: pi.GeneralizedAlpha(H=1e-3), "h"),
        (lambda: pi.GeneralizedAlpha.hht(1e-3, rho=0.5), "rho_inf"),
        (lambda: pi.IDA(rtoll=1e-3), "rtol"),
        (lambda: pi.mesh.rectangle(1.0, 0.1, cell=4), "cells"),
        (lambda: pi.Material(E=1.0, nu=0.3, density=1.0, rhoo=2.0), None),
    ],
)
def test_what_is_near_is_proposed(call, meant):
    with pytest.raises(pi.InputError, match=f"did you mean '{meant}'" if meant else "'density'; it takes E, nu, rho, plane") as raised:
        call()
    assert isinstance(raised.value, TypeError)


def test_signatures_stay():
    assert list(inspect.signature(pi.solve).parameters)[:3] == ["model", "t_end", "integrator"]
    assert list(inspect.signature(pi.Material).parameters)[:3] == ["E", "nu", "rho"]
    assert inspect.isclass(pi.Plate) and pi.solve.__doc__.startswith("Run an integrator")
    assert pickle.loads(pickle.dumps(pi.solve)) is pi.solve


def test_further_keywords_and_errors_from_inside_pass():
    @named_keywords
    def inner(a, *, b=2):
        return {}["missing"] if b else a

    assert inner(1, b=0) == 1
    with pytest.raises(KeyError):
        inner(a=1)
    with pytest.raises(TypeError, match="inner: a is missing; it takes a, b"):
        inner()
