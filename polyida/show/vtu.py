"""`pi.export`: frames of a run as VTU files with a PVD collection, for ParaView."""

from __future__ import annotations

import os
import re
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.files import OLD, disk_errors, remove_left_over, replacing, write_file
from polyida.io.locks import HAS_LOCKS, being_written, lock
from polyida.show import plates
from polyida.validation import as_array, is_whole, named_keywords, path_of

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

__all__ = ["vtu"]
COLLECTION = "run.pvd"
KINDS = {(3, 1): "triangle", (4, 1): "quad", (6, 2): "triangle6", (8, 2): "quad8"}  # by the nodes of a cell and its order
JOURNAL = ".polyida-{}.frames"  # names of the frames that a process is writing
FRAME = re.compile(r"frame-[a-z]?\d+\.vtu")


def __dir__():
    """Return the public names of the module, `__all__`, for `dir()`."""
    return __all__


@named_keywords
def vtu(run: Trajectory, folder: str | Path, overwrite: bool = False, frames: int | ArrayLike | None = None) -> Path:
    """Write one VTU file for each frame, and run.pvd with their times.

    Parameters
    ----------
    run : Trajectory
        A run with plates.
    folder : str or Path
    overwrite : bool
        Replace the frames of an earlier export, when the new ones are whole: until then these have a letter in their names. Other files in the
        folder stay.
    frames : int or (k,) int, optional
        Largest number of frames, evenly spread in time, or indices of frames. None: all frames.

    Returns
    -------
    path : Path
        run.pvd, which ParaView opens.

    Raises
    ------
    InputError
        If the folder already has frames and `overwrite` is False, and for a run without plates.

    Notes
    -----
    Points are current positions, m. Point data: displacement, m, and velocity, m/s. Cell data: von Mises stress and Cauchy stress
    (xx, yy, xy), Pa, and the number of the plate.
    """
    folder = path_of("export", "folder", folder)
    plates.require_run("export", run, overwrite)
    if not run.model.drawn:
        raise InputError("export: no body of the scene has a mesh")
    cells = _CellBlocks(run.model)
    if frames is None:
        indices = np.arange(len(run.t))
    elif is_whole(frames):
        indices = plates.spread(run, frames)
    else:
        indices = as_array(frames)
        indices = np.zeros(0) if indices is None or not indices.ndim else indices
        if indices.dtype.kind not in "iu" or not indices.size or not (np.abs(indices + 0.5) < len(run.t)).all():
            raise InputError(f"export: frames = {frames!r} must be how many, or indices of the run's {len(run.t)} frames")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"export folder {folder} is a file")
    if (folder / COLLECTION).exists() and not overwrite:
        raise InputError(f"export folder {folder} holds frames already: choose another folder, or pass overwrite=True (--overwrite)")
    with disk_errors(f"export folder {folder}"):
        _write(run, folder, indices, cells)
    return folder / COLLECTION


def _write(run, folder, indices, cells):
    """Write the frames of a run and their collection, then remove those of an earlier one."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_left_over(folder)
    _remove_left_over_frames(folder)
    old = _frames_of(folder / COLLECTION)
    names = _free_names(folder, len(indices))
    with _journal(folder) as note:
        try:
            note(names)
            for name, k in zip(names, indices):
                with replacing(folder / name) as part:
                    cells.frame(run, int(k)).write(part, file_format="vtu")
            _write_collection(folder / COLLECTION, names, run.t[indices])
        except BaseException:  # the old frames stay
            for name in names:
                (folder / name).unlink(missing_ok=True)
            raise
        note(old)
        for name in old:
            (folder / name).unlink(missing_ok=True)
        plain = _free_names(folder, len(indices))
        if names[0] != plain[0] and plain[0] == f"frame-{0:05d}.vtu":  # the old ones had the plain names
            note(plain)
            with suppress(OSError):  # a file system without links
                for name, new in zip(names, plain):
                    os.link(folder / name, folder / new)
                _write_collection(folder / COLLECTION, plain, run.t[indices])
                for name in names:
                    (folder / name).unlink()


@contextmanager
def _journal(folder):
    """Context that gives a function(names): these frames are removed by the next export if this process is killed and the collection lacks them."""
    path = folder / JOURNAL.format(uuid4().hex)
    try:
        with open(path, "w", encoding="utf-8") as file:
            lock(file)

            def note(names):
                """Append names of frames to the journal and write them to the disk's cache at once."""
                file.write("".join(f"{name}\n" for name in names))
                file.flush()

            yield note
    finally:
        path.unlink(missing_ok=True)


def _remove_left_over_frames(folder):
    """Remove the frames of exports whose process was killed."""
    for path in folder.glob(JOURNAL.format("*")):
        with suppress(OSError):
            is_old = time.time() - path.stat().st_mtime > OLD
            names = path.read_text(encoding="utf-8").split("\n")[:-1]
            if being_written(path) or not is_old and not (HAS_LOCKS and names):  # an empty one may be locked next
                continue
            kept = _frames_of(folder / COLLECTION)
            for name in names:
                if FRAME.fullmatch(name) and name not in kept:
                    (folder / name).unlink(missing_ok=True)
            path.unlink()


def _free_names(folder, count):
    """Names of frames that no file in the folder has: `frame-00000.vtu`, or with a letter where an earlier export or the user has these."""
    for letter in ("", *ascii_lowercase):
        names = [f"frame-{letter}{i:05d}.vtu" for i in range(count)]
        if not any((folder / name).exists() for name in names):
            return names
    raise InputError(f"export folder {folder} holds frames of many names; choose another folder")


def _frames_of(collection):
    """The names of the frames that an earlier export wrote, in the folder of its collection; empty without one."""
    if not collection.exists():
        return set()
    return set(re.findall(f'file="({FRAME.pattern})"', collection.read_text(encoding="utf-8", errors="replace")))


def _write_collection(path, names, times):
    """Write the file that names all frames with their times, s. ParaView opens it."""
    entries = "".join(f'    <DataSet timestep="{float(t)!r}" part="0" file="{name}"/>\n' for name, t in zip(names, times))
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>\n'
    write_file(path, f"{head}{entries}  </Collection>\n</VTKFile>\n")


class _CellBlocks:
    """The cells of a model in blocks with the same number of corners; meshio writes polygons only in this form."""

    def __init__(self, model):
        """Sort the cells of all plates by kind, with corners before middle nodes in cells of order 2 that VTK knows."""
        nodes, offsets = plates.connectivity(model)
        corners = np.diff(offsets)
        orders = np.concatenate([np.full(body.mesh.n_cells, body.mesh.order) for body in plates.bodies(model)])
        kinds = np.unique(np.column_stack([corners, orders]), axis=0).tolist()
        self.order = [np.flatnonzero((corners == count) & (orders == order)) for count, order in kinds]
        self.cells = []
        for (count, order), cells in zip(kinds, self.order):
            kind, places = KINDS.get((count, order), "polygon"), np.arange(count)
            if order == 2 and kind != "polygon":  # VTK lists the corners first
                places = np.concatenate([places[::2], places[1::2]])
            self.cells.append((kind, nodes[offsets[cells][:, None] + places]))
        cells = [body.mesh.n_cells for body in plates.bodies(model)]
        self.plate = np.repeat(np.arange(len(cells)), cells)

    def frame(self, run, k):
        """Frame k as a meshio.Mesh."""
        import meshio

        displacement, velocity = (run.model.nodal(np.asarray(values[k], float)) for values in (run.q, run.v))
        cell_data = {"von Mises": run.von_mises(k), "stress": run.stress(k), "plate": self.plate}
        return meshio.Mesh(
            _with_z(run.node_positions(k)),
            self.cells,
            point_data={"displacement": _with_z(displacement), "velocity": _with_z(velocity)},
            cell_data={name: [values[cells] for cells in self.order] for name, values in cell_data.items()},
        )


def _with_z(vectors):
    """Plane vectors (n, 2) with a third component of zero, which VTU requires."""
    return np.column_stack([vectors, np.zeros(len(vectors))])
