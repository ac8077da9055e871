"""`pi.export`: frames of a run as VTU files with a PVD collection, for ParaView."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.show import plates
from polyida.validation import is_whole, named_keywords

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

__all__ = ["vtu"]
COLLECTION = "run.pvd"


def __dir__():
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
        Replace the frames that the folder already has.
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
    if not isinstance(folder, (str, Path)) or not str(folder):
        raise InputError(f"export folder {folder!r} must be the path of a folder")
    plates.require_run("export", run, overwrite)
    if not run.model.drawn:
        raise InputError("export: no body of the scene has a mesh")
    folder, cells = Path(folder), _CellBlocks(run.model)
    if frames is None:
        indices = np.arange(len(run.t))
    elif is_whole(frames):
        indices = plates.spread(run, frames)
    else:
        indices = np.atleast_1d(frames) if np.ndim(frames) else np.zeros(0)
        if indices.dtype.kind not in "iu" or not indices.size or not (np.abs(indices + 0.5) < len(run.t)).all():
            raise InputError(f"export: frames = {frames!r} must be how many, or indices of the run's {len(run.t)} frames")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"export folder {folder} is a file")
    old = [*folder.glob("frame-*.vtu"), *folder.glob(COLLECTION)] if folder.exists() else []
    if old and not overwrite:
        raise InputError(f"export folder {folder} holds frames already: choose another folder, or pass overwrite=True (--overwrite)")
    folder.mkdir(parents=True, exist_ok=True)
    for path in old:
        path.unlink()
    names = [f"frame-{i:05d}.vtu" for i in range(len(indices))]
    for name, k in zip(names, indices):
        cells.frame(run, int(k)).write(folder / name, file_format="vtu")
    entries = "".join(f'    <DataSet timestep="{float(t)!r}" part="0" file="{name}"/>\n' for name, t in zip(names, run.t[indices]))
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>\n'
    path = folder / COLLECTION
    path.write_text(f"{head}{entries}  </Collection>\n</VTKFile>\n", encoding="utf-8")
    return path


class _CellBlocks:
    """The cells of a model in blocks with the same number of corners; meshio writes polygons only in this form."""

    def __init__(self, model):
        nodes, offsets = plates.connectivity(model)
        corners = np.diff(offsets)
        kinds = np.unique(corners)
        self.order = [np.flatnonzero(corners == count) for count in kinds]
        self.cells = [
            ({3: "triangle", 4: "quad"}.get(int(count), "polygon"), nodes[offsets[cells][:, None] + np.arange(count)])
            for count, cells in zip(kinds, self.order)
        ]
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
