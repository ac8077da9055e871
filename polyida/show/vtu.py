"""VTU frames of a run with a PVD collection, for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.show import plates
from polyida.validation import is_whole, named_keywords

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

COLLECTION = "run.pvd"


@named_keywords
def vtu(run: "Trajectory", folder: str | Path, overwrite: bool = False, frames: int | ArrayLike | None = None) -> Path:
    """Write one VTU file a frame into `folder`, and run.pvd, which holds their times; returns the path of run.pvd.

    Points are the current positions in m. Point data: displacement (m), velocity (m/s). Cell data: von Mises stress and
    the Cauchy stress (xx, yy, xy), Pa; the number of the plate. frames: how many at most, evenly spread in time (all
    where None), or frame indices. Raises InputError where the folder holds frames already and `overwrite` is not given,
    and for a run that has no plates.
    """
    if not isinstance(folder, (str, Path)) or not str(folder):
        raise InputError(f"export folder {folder!r} must be the path of a folder")
    plates.require_run("export", run, overwrite)
    if not run.model.drawn:
        raise InputError("export: no body of the scene has a mesh")
    folder, blocks, chosen = Path(folder), _Blocks(run.model), _chosen(run, frames)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"export folder {folder} is a file")
    old = [*folder.glob("frame-*.vtu"), *folder.glob(COLLECTION)] if folder.exists() else []
    if old and not overwrite:
        raise InputError(f"export folder {folder} holds frames already: choose another folder or say overwrite")
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in old:
        earlier.unlink()
    for i, k in enumerate(chosen):
        blocks.mesh(run, int(k)).write(folder / _name(i), file_format="vtu")
    path = folder / COLLECTION
    with open(path, "w", encoding="utf-8") as file:
        file.write('<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>\n')
        file.writelines(f'    <DataSet timestep="{float(t)!r}" part="0" file="{_name(i)}"/>\n' for i, t in enumerate(run.t[chosen]))
        file.write("  </Collection>\n</VTKFile>\n")
    return path


def _chosen(run, frames):
    """Indices of frames from how many there may be, or from themselves."""
    if frames is None:
        return np.arange(len(run.t))
    if is_whole(frames):
        return plates.spread(run, frames)
    chosen = np.atleast_1d(frames) if np.ndim(frames) else np.zeros(0)
    if chosen.dtype.kind not in "iu" or not chosen.size or not (np.abs(chosen + 0.5) < len(run.t)).all():
        raise InputError(f"export: frames = {frames!r} must be how many, or indices of the run's {len(run.t)} frames")
    return chosen


def _name(i):
    return f"frame-{i:05d}.vtu"


class _Blocks:
    """The cells of a model as blocks of equal corner count, the only form in which meshio writes polygons."""

    def __init__(self, model):
        nodes, offsets = plates.connectivity(model)
        corners = np.diff(offsets)
        self.order = [np.flatnonzero(corners == count) for count in np.unique(corners)]
        self.cells = [(_kind(count), nodes[offsets[of][:, None] + np.arange(count)]) for count, of in zip(np.unique(corners), self.order)]
        cells = [body.mesh.n_cells for body in plates.bodies(model)]
        self.plate = np.repeat(np.arange(len(cells)), cells)

    def mesh(self, run, k):
        """Frame k as a meshio.Mesh."""
        import meshio

        positions, stress = run.node_positions(k), run.stress(k)
        displacement, velocity = (run.model.nodal(np.asarray(frames[k], float)) for frames in (run.q, run.v))
        cell_data = {"von Mises": run.von_mises(k), "stress": stress, "plate": self.plate}
        return meshio.Mesh(
            _flat(positions),
            self.cells,
            point_data={"displacement": _flat(displacement), "velocity": _flat(velocity)},
            cell_data={name: [values[of] for of in self.order] for name, values in cell_data.items()},
        )


def _kind(corners):
    return {3: "triangle", 4: "quad"}.get(int(corners), "polygon")


def _flat(vectors):
    """Plane vectors (n, 2) with a third component of zero, which VTU asks for."""
    return np.column_stack([vectors, np.zeros(len(vectors))])
