"""Every argument of every public function, class and method gets every kind of bad value: an InputError, or a result, and nothing else."""

import random

import pytest
from fuzzing import INSTANCES, SLOW, answer, call, callables, changes, classes, function_of, good_call, methods

import polyida as pi

NAMES = [*callables(), *methods()]
MADE_OF_ARRAYS = [name for name in callables() if name.partition(".")[0] in ("mesh", "profile", "objective") or name in pi.registry.parts]
HANDED_OUT = {
    "Trajectory",
    "Modes",
    "Buckling",
    "Fit",
    "Steady",
    "Campbell",
    "StateSpace",
    "ErrorBars",
    "EquilibriumPath",
    "FrequencyResponse",
    "Gradient",
    "Sweep",
    "Result",
    "RunPlots",
}


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    from matplotlib import pyplot

    pyplot.close("all")


def test_what_is_handed_out_has_an_instance():
    assert HANDED_OUT <= {*INSTANCES} <= {*classes(), "Domain"}


@pytest.mark.parametrize("name", NAMES)
def test_bad_values_are_refused(name):
    function = function_of(name)
    good = good_call(name, function)
    call(function, good)
    answers = {(key, label): answer(function, values) for key, label, values in changes(name, function, good)}
    assert not {case: what for case, what in answers.items() if what}


def test_a_sample_of_bad_values_is_refused():
    """Of parts, meshes, profiles and objectives, which take no compiled kernel to make."""
    cases, draw = [], random.Random(1)
    for name in MADE_OF_ARRAYS:
        if name.rpartition(".")[2] not in SLOW:
            function = function_of(name)
            good = good_call(name, function)
            cases += [(name, key, label, function, values) for key, label, values in changes(name, function, good)]
    answers = {case[:3]: answer(*case[3:]) for case in draw.sample(cases, 400)}
    assert not {case: what for case, what in answers.items() if what}
