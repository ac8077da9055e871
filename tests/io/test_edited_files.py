"""A file of a run that somebody edited is refused by `resume` as by `load`: an InputError that names the file, never an error from inside."""

import json
import zlib

import h5py
import numpy as np
import pytest

import polyida as pi
from polyida.io.layout import HEAD

MODEL = pi.problems.get("pendulum").model
WRONG = [None, "text", -1, 0, 0.5, [], {}, [1.0, "a"], [[1.0]], 10**400, True]


@pytest.fixture
def path(tmp_path):
    pi.solve(MODEL, 0.01, pi.GeneralizedAlpha(h=1e-3), q0=[-1.0, 0.0], out=tmp_path / "run.h5")
    return tmp_path / "run.h5"


def edit(path, change):
    """Change the plain data of a file."""
    with h5py.File(path, "r+") as file:
        about = json.loads(file["about"][:].tobytes())
        change(about)
        del file["about"]
        file.create_dataset("about", data=np.frombuffer(json.dumps(about).encode(), np.uint8))


def complaint(path):
    """None if the run goes on, or is refused by a message that names the file; else what came."""
    try:
        pi.resume(path, 0.02, model=MODEL)
    except pi.InputError as error:
        return None if "run.h5" in str(error) else str(error)
    except Exception as error:  # noqa: BLE001, what else may come is what is looked for
        return f"{type(error).__name__}: {error}"
    return None


@pytest.mark.parametrize("key", ["t_end", "every", "output", "until", "flush_every", "fsync", "precision", "began"])
def test_an_edited_plan(key, path):
    content, answers = path.read_bytes(), {}
    for value in WRONG:
        path.write_bytes(content)
        edit(path, lambda about, value=value: about["plan"].update({key: value}))
        answers[str(value)[:20]] = complaint(path)
    path.write_bytes(content)
    edit(path, lambda about: about["plan"].pop(key))
    answers["none"] = complaint(path)
    assert not {value: answer for value, answer in answers.items() if answer}


@pytest.mark.parametrize("key", ["machine", "plan", "integrator", "model", "drives"])
def test_an_edited_head(key, path):
    content, answers = path.read_bytes(), {}
    for value in WRONG:
        path.write_bytes(content)
        edit(path, lambda about, value=value: about.update({key: value}))
        answers[str(value)[:20]] = complaint(path)
    assert not {value: answer for value, answer in answers.items() if answer}


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA()])
def test_an_edited_name_in_the_memory_of_an_integrator(integrator, tmp_path):
    """Each entry in turn has another name: the run goes on without it, or is refused."""
    path = tmp_path / "run.h5"
    run = pi.solve(MODEL, 0.01, integrator, q0=[-1.0, 0.0], out=path)
    content, memory = path.read_bytes(), run.state.memory
    assert memory
    for name in memory:
        path.write_bytes(content)
        with h5py.File(path, "r+") as file:
            for slot in ("slot 0", "slot 1"):
                stored = file[slot][:].tobytes()
                if not stored:
                    continue
                length, _, text = HEAD.unpack_from(stored)
                body = stored[HEAD.size : HEAD.size + length]
                changed = body[:text].replace(f'"{name}"'.encode(), f'"{"x" * len(name)}"'.encode(), 1) + body[text:]
                whole = HEAD.pack(len(changed), zlib.crc32(changed), text) + changed
                file[slot].resize((len(whole),))
                file[slot][:] = np.frombuffer(whole, np.uint8)
        try:
            assert pi.resume(path, 0.02, model=MODEL).success
        except pi.InputError as error:
            assert "run.h5" in str(error) and repr(name) in str(error)
