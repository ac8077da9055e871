"""Files that nobody vouches for: damaged, foreign and hostile ones end in one InputError that names the file."""

import json
import random
import struct
import zlib
from contextlib import suppress

import h5py
import numpy as np
import pytest

import polyida as pi
from polyida.io.layout import HEAD
from polyida.io.unclosed import checksum
from polyida.problems import plates


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "run.h5"
    pi.solve(plates.double_plate_motors(cells=6).build(), 0.02, pi.GeneralizedAlpha(h=1e-3), out=path)
    return path.read_bytes()


@pytest.fixture
def path(good, tmp_path):
    (tmp_path / "run.h5").write_bytes(good)
    return tmp_path / "run.h5"


def refused(path, *words):
    with pytest.raises(pi.InputError) as error:
        pi.load(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert all(word in str(error.value) for word in words), str(error.value)
    with pytest.raises(pi.InputError, match="run.h5"):
        pi.resume(path, 0.03)


def replaced(file, name, values, **options):
    del file[name]
    file.create_dataset(name, data=values, **options)


def chunked(file, name, rows):
    """Claim that so many frames are in one piece, which nobody wrote."""
    shape = file[name].shape
    del file[name]
    file.create_dataset(name, shape, "f8", chunks=(rows, *shape[1:]), maxshape=(None, *shape[1:]), fletcher32=True)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x89HDF\r\n\x1a\n", b"t,x\n0,1\n" * 50, random.Random(0).randbytes(4096)],
    ids=["empty", "signature", "text", "noise"],
)
def test_foreign_files(tmp_path, content):
    (tmp_path / "run.h5").write_bytes(content)
    refused(tmp_path / "run.h5")


def test_another_hdf5_file(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["q"] = np.zeros(3)
    refused(tmp_path / "run.h5", "not a polyida trajectory")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.9999])
def test_truncated_files(path, good, part):
    path.write_bytes(good[: int(part * len(good))])
    refused(path)


@pytest.mark.parametrize("seed", range(40))
def test_damaged_bytes_never_end_in_anything_else(path, good, seed):
    """What is read after random damage, mostly where the structure lies, is a trajectory or an InputError."""
    draw, damaged = random.Random(seed), bytearray(good)
    for _ in range(draw.randrange(1, 6)):
        damaged[draw.randrange(20_000)] = draw.randrange(256)
    path.write_bytes(damaged)
    try:
        run = pi.load(path)
        assert np.isfinite(run.q).all() and len(run.q) == len(run.t)
    except pi.InputError as error:
        assert "run.h5" in str(error)


HOSTILE = {
    "does not hold numbers": lambda f: replaced(f, "q", np.full((21, f["q"].shape[1]), b"x", "S1")),
    "has the shape": lambda f: replaced(f, "v", np.zeros((21, 3))),
    "virtual, external or compressed": lambda f: replaced(f, "a", f["a"][()], compression="gzip"),
    "is not in the file": lambda f: f.__delitem__("t"),
    "frames, 21 are stated": lambda f: f["q"].resize(5, axis=0),
    "no whole record": lambda f: [f[f"slot {slot}"].resize(0, axis=0) for slot in range(2)],
    "q claims": lambda f: chunked(f, "q", 1 << 20),
    "claims": lambda f: (
        replaced(f, "scene/mesh 0/points", np.zeros(1), maxshape=(None,)) or f["scene/mesh 0/points"].resize(1 << 50, axis=0)
    ),
}


@pytest.mark.parametrize("word", HOSTILE)
def test_hostile_contents(path, word):
    with h5py.File(path, "r+") as file:
        HOSTILE[word](file)
    refused(path, word)


def test_no_link_leads_out_of_the_file(path, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["q"] = np.zeros((21, 8))
    with h5py.File(path, "r+") as file:
        del file["q"]
        file["q"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "q")
    refused(path, "q is not in the file")


def test_no_raw_data_of_other_files(path, tmp_path):
    (tmp_path / "secret").write_bytes(bytes(8 * 21 * 60))
    with h5py.File(path, "r+") as file:
        shape = file["q"].shape
        del file["q"]
        file.create_dataset("q", shape, "f8", external=[(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)])
    refused(path, "external")


def about(path, change):
    with h5py.File(path, "r+") as file:
        data = json.loads(file["about"][()].tobytes())
        change(data)
        replaced(file, "about", np.frombuffer(json.dumps(data).encode(), np.uint8))


def part_of(data, kind):
    return next(part["fields"] for part in data["scene"]["parts"] if part["kind"] == kind)


ABOUT = {
    "material": lambda data: part_of(data, "Plate")["material"].update(material=[-1, 0.3, 1, "stress"]),
    "setting": lambda data: data["integrator"]["settings"].update(h=-1),
    "unknown setting": lambda data: data["integrator"]["settings"].update(hook="x"),
    "mesh": lambda data: part_of(data, "Plate")["mesh"].update(mesh="no mesh"),
    "body": lambda data: part_of(data, "PointMass")["at"]["side"].update(body="nobody"),
    "length": lambda data: part_of(data, "PointMass")["at"]["side"].update(length=float("nan")),
    "mass": lambda data: part_of(data, "PointMass").update(mass="heavy"),
    "angle": lambda data: part_of(data, "AngleMotor").update(angle={"profile": ["__import__", "os"]}),
    "ground": lambda data: part_of(data, "Revolute").update(a={"ground": [["x"], 0]}),
    "unknown field": lambda data: part_of(data, "PointMass").update(hook="x"),
    "gravity": lambda data: data["scene"].update(gravity="down"),
    "no scene": lambda data: data["scene"].update(parts=[]),
    "a list": lambda data: data.update(plan=3, machine=4),
}


@pytest.mark.parametrize("what", ABOUT)
def test_descriptions_that_describe_nothing(path, what):
    about(path, ABOUT[what])
    refused(path)


@pytest.mark.parametrize("kind", ["os.system", "__main__.Unheard", ""])
def test_a_part_of_an_unknown_kind_is_named_and_the_frames_are_there(path, kind):
    about(path, lambda data: data["scene"]["parts"][-1].update(kind=kind))
    run = pi.load(path)
    assert run.model is None and len(run) > 1
    assert "define or import that class" in run.summary()
    uses = [
        lambda: run.drift,
        lambda: run.save(path.with_suffix(".again")),
        lambda: run.plot.reactions(),
        lambda: pi.gradient(run, pi.objective.StrainEnergy()),
        lambda: pi.objective.UserObjective(lambda run: run.model.n, lambda run: {})(run),
        lambda: pi.pod_modes(run, "bar"),
    ]
    for use in uses:
        with pytest.raises(pi.InputError, match="define or import that class"):
            use()
    for use in (lambda: pi.modes(run.model), lambda: pi.solve(run.model, 1.0, pi.IDA(), state=run.state)):
        with pytest.raises(pi.InputError, match="a run that was loaded has none where a class of its file is not known"):
            use()


def test_deep_json(path):
    with h5py.File(path, "r+") as file:
        replaced(file, "about", np.frombuffer(b"[" * 200_000, np.uint8))
    refused(path)


def test_nodes_and_weights_that_do_not_fit(path):
    def damaged(key, values):
        with h5py.File(path, "r+") as file:
            names = []
            file["scene"].visit(lambda name: names.append(name) if name.endswith(key) else None)
            replaced(file, f"scene/{names[0]}", values)
        refused(path, "scene")

    for key, values in (("at/nodes", np.array([10**6])), ("at/weights", np.ones(1)), ("at/nodes", np.array([0.5]))):
        damaged(key, values)


def rewritten(path, **changes):
    """The record of both slots changed by somebody who knows how, what is behind it left."""
    with h5py.File(path, "r+") as file:
        for slot in range(2):
            stored = file[f"slot {slot}"][()].tobytes()
            length, _, text = HEAD.unpack_from(stored)
            body = stored[HEAD.size : HEAD.size + length]
            record = json.dumps(json.loads(body[:text]) | changes).encode()
            body = record + body[text:]
            new = HEAD.pack(len(body), zlib.crc32(body), len(record)) + body
            file[f"slot {slot}"].resize(len(new), axis=0)
            file[f"slot {slot}"][:] = np.frombuffer(new, np.uint8)


CHANGES = {
    "are stated": {"frames": 10**12},
    "are damaged": {"frames": 10**12, "tail": 10**12},
    "or the state to go on from": {"memory": [["a_alg", [10**9]]]},
    "the count steps": {"counts": {"steps": "many"}},
    "go on from is damaged": {"restart": {"frames": 22, "counts": {}}},
}


@pytest.mark.parametrize("words", CHANGES)
def test_a_record_that_was_changed_on_purpose(path, words):
    rewritten(path, **CHANGES[words])
    refused(path, words)


def test_the_mark_of_an_unclosed_file_is_taken_off_when_reading(path, good):
    head = bytearray(good[:48])
    assert struct.unpack("<I", head[44:])[0] == checksum(head[:44])
    head[11] = 5
    head[44:] = struct.pack("<I", checksum(head[:44]))
    path.write_bytes(head + good[48:])
    with pytest.raises(OSError):
        h5py.File(path, "r")
    assert len(pi.load(path)) == 21 and path.read_bytes()[11] == 5
    path.write_bytes(head + good[48:20_000] + bytes(200) + good[20_200:])
    with suppress(pi.InputError):
        pi.load(path)


DAMAGE = {
    "shorter": lambda x: x[:-1] if np.ndim(x) and len(x) > 1 else None,
    "narrower": lambda x: x[:, :-1] if np.ndim(x) > 1 else None,
    "empty": lambda x: x[:0] if np.ndim(x) else None,
    "a number": lambda x: 1.0,
    "text": lambda x: "hello",
    "large": lambda x: x + 10**6 if np.asarray(x).dtype.kind in "if" else None,
    "negative": lambda x: -1 - x if np.asarray(x).dtype.kind == "i" else None,
    "not finite": lambda x: x * np.nan if np.asarray(x).dtype.kind == "f" else None,
}


@pytest.mark.parametrize("change", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_damaged_scene_is_refused_or_harmless(file, change):
    """Each dataset of the scene in turn. Kernels do not check bounds, so what they are given must have been checked."""
    content, names, changed = file.read_bytes(), [], 0
    with h5py.File(file, "r") as opened:
        opened["scene"].visititems(lambda name, node: names.append(f"scene/{name}") if hasattr(node, "dtype") else None)
    for name in names:
        file.write_bytes(content)
        with h5py.File(file, "r+") as opened:
            value = change(opened[name][()])
            if value is None:
                continue
            del opened[name]
            opened[name] = value
        changed += 1
        try:
            run = pi.load(file)
        except pi.InputError as error:
            assert file.name in str(error)
        else:
            run.energy, run.drift, run.summary(), run.stress(-1), run.position("tip"), run.reaction("joint")
    assert changed
