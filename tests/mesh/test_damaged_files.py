"""Damaged and hostile files of all formats that are read: an InputError that names the file, or a mesh, and no warning but MeshWarning.

`python tests/mesh/test_damaged_files.py 1000` tries more of them and reports the slowest.
"""

import re
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, Outline, PolygonMesh, read, read_outline, triangles, write, write_outline

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
HOSTILE = [b"nan", b"inf", b"-inf", b"1e308", b"-1", b"0", b"4294967296", b"99999999999999999999", b"1e-320", b"2147483647", b""]
DECK = """*HEADING
plate
*PART, NAME=P
*NODE, NSET=ALL
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
*NGEN, NSET=LOW
1, 2, 1
*ELEMENT, TYPE=CPS4, ELSET=E
1, 1, 2, 3, 4
*NSET, NSET=SOME, GENERATE
1, 4, 1
*END PART
*ASSEMBLY, NAME=A
*INSTANCE, NAME=P-1, PART=P
1., 2., 0.
0., 0., 0., 0., 0., 1., 30.
*END INSTANCE
*NSET, NSET=TIP, INSTANCE=P-1
2, 3
*END ASSEMBLY
*BOUNDARY
TIP, 1, 2
"""
SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="50mm" viewBox="0 0 200 100"><g transform="rotate(30 10 10) scale(2)">
<rect x="1" y="2" width="50" height="40" rx="3"/><circle cx="20" cy="20" r="5"/><path d="M 30 20 l 5 0 a 3 3 0 0 1 -3 4 q 1 1 -2 -1 z"/></g>
<defs><g id="a"><ellipse cx="9" cy="9" rx="2" ry="1"/></g></defs><use href="#a" x="3"/></svg>"""


def drawing(path):
    import ezdxf

    document = ezdxf.new(units=4)
    block = document.blocks.new("hole")
    block.add_circle((0, 0), 1)
    space = document.modelspace()
    space.add_lwpolyline([(0, 0), (100, 0), (100, 50, 0, 0, 1.0), (0, 50)], close=True)
    space.add_blockref("hole", (20, 20), dxfattribs={"rotation": 30, "row_count": 2, "row_spacing": 4})
    space.add_spline([(50, 20), (60, 20), (55, 30), (50, 20)])
    space.add_ellipse((80, 25), (8, 0), 0.5)
    document.saveas(path)


def seeds(folder):
    """{name: content} of whole files."""
    mesh = triangles(1.0, 0.2, 3, 2)
    for suffix in ("vtu", "vtk", "obj", "msh", "msh4", "inp", "mesh", "mat"):
        write(mesh, folder / f"whole.{suffix}")
    write_outline(mesh, folder / "plain.dxf")
    drawing(folder / "whole.dxf")
    import meshio

    points, cells = np.column_stack([mesh.points, np.zeros(mesh.n_nodes)]), [("triangle", mesh.nodes.reshape(-1, 3))]
    meshio.Mesh(points, cells).write(folder / "binary.msh", file_format="gmsh", binary=True)
    meshio.Mesh(points, cells).write(folder / "ascii.vtk", file_format="vtk", binary=False)
    (folder / "deck.inp").write_text(DECK)
    (folder / "whole.svg").write_text(SVG)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def damaged(content, rng):
    """A truncated file, one with other bytes, with parts twice, or with other numbers."""
    kind = int(rng.integers(4))
    a, b = np.sort(rng.integers(0, len(content), 2)).tolist()
    if kind == 0:
        return content[:a]
    if kind == 1:
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 1 + int(rng.integers(4))):
            changed[place] = int(rng.integers(256))
        return bytes(changed)
    if kind == 2:
        return content[:b] + content[a:]
    found = list(NUMBER.finditer(content))
    for match in sorted(rng.choice(len(found), 1 + int(rng.integers(3))).tolist(), reverse=True):
        content = content[: found[match].start()] + HOSTILE[int(rng.integers(len(HOSTILE)))] + content[found[match].end() :]
    return content


def tried(path, content):
    """The mesh, outline or InputError of a file."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", MeshWarning)
        try:
            result = read_outline(path) if path.suffix in (".svg", ".dxf") else read(path)
        except InputError as error:
            assert path.name in str(error)
            return error
    assert isinstance(result, Outline | PolygonMesh)
    return result


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return seeds(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("name", ["vtu", "vtk", "obj", "msh", "msh4", "inp", "mesh", "mat", "dxf", "svg"])
def test_damaged_files_end_in_one_message(whole, tmp_path, capfd, name):
    rng = np.random.default_rng(7)
    for file, content in whole.items():
        if file.endswith("." + name):
            assert not isinstance(tried(tmp_path / file, content), InputError)
            for _ in range(8):
                tried(tmp_path / file, damaged(content, rng))
    assert capfd.readouterr() == ("", "")


if __name__ == "__main__":
    folder = Path(tempfile.mkdtemp())
    (folder / "seeds").mkdir()
    for file, content in seeds(folder / "seeds").items():
        times, inner = [], set()
        for seed in range(int(sys.argv[1])):
            begin = time.perf_counter()
            try:
                outcome = tried(folder / file, damaged(content, np.random.default_rng(seed)))
            except Exception as error:  # noqa: BLE001, all are reported
                print(file, seed, repr(error)[:300])
                continue
            times.append((time.perf_counter() - begin, seed))
            if isinstance(outcome, InputError) and "inconsistent data" in str(outcome):
                inner.add(re.sub(r"\d+", "0", str(outcome).split("inconsistent data:")[1])[:100])
        print(f"{file}: {len(times)} ended, the slowest in {max(times)[0]:.2f} s (seed {max(times)[1]}); other errors: {sorted(inner)}")
