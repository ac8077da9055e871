"""The two bars in space: frames for ParaView, an animation and a picture: `python studies/polyhedra/pictures.py FOLDER`."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

sys.path.insert(0, str(Path(__file__).parents[1]))

import polyida as pi
from polyhedra.cases import bars
from polyhedra.mesh import write_vtu


def draw(axes, model, shapes, path):
    """Draw the outer faces at each (q, colour), and the path of the tip, on axes of equal scale."""
    for q, colour in shapes:
        x = model.points + model.displacements(q)[model.number]
        faces = [x[start + face] for mesh, start in zip(model.meshes, model.starts) for face in mesh.outer]
        axes.add_collection3d(Poly3DCollection(faces, facecolors=colour, edgecolors="#222222", linewidths=0.2, shade=True))
    axes.plot(*path.T, color="#c44e52", linewidth=1.0)
    axes.set(xlim=(-1.8, 2.2), ylim=(-0.8, 1.2), zlim=(-1.9, 0.3), xlabel="x, m", ylabel="y, m", zlabel="z, m", aspect="equal")
    axes.locator_params(nbins=5)
    axes.view_init(18, -62)


def main(folder, cells=60, t_end=1.0):
    """Write bars.png, bars.gif, and run.pvd with the frames of both bars."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    model, v0, tip = bars(cells)
    run = pi.solve(model, t_end, pi.EnergyMomentum(h=1e-3), v0=v0, every=20)
    path, blue = np.array([model.place(tip, q) for q in run.q]), np.array([0.55, 0.7, 1.0])
    axes = (fig := plt.figure(figsize=(8.0, 6.0))).add_subplot(projection="3d")
    shares = np.linspace(0.0, 1.0, 5)
    draw(axes, model, [(run.q[int(share * (len(run.t) - 1))], blue * (1.0 - 0.5 * share)) for share in shares], path)
    fig.savefig(folder / "bars.png", dpi=150, bbox_inches="tight")

    def frame(k):
        axes.clear()
        draw(axes, model, [(run.q[k], blue)], path[: k + 1])
        axes.set_title(f"t = {run.t[k]:.2f} s")

    FuncAnimation(fig, frame, len(run.t)).save(folder / "bars.gif", PillowWriter(fps=20), dpi=80)
    entries = []
    for k, (t, q) in enumerate(zip(run.t, run.q)):
        moved = model.points + model.displacements(q)[model.number]
        for body, (mesh, points) in enumerate(zip(model.meshes, np.split(moved, model.starts[1:-1]))):
            entries.append(f'<DataSet timestep="{t:.9g}" part="{body}" file="bar-{body}-{k:03d}.vtu"/>')
            write_vtu(folder / f"bar-{body}-{k:03d}.vtu", mesh, points, {"cell": np.arange(len(mesh.cells))})
    (folder / "run.pvd").write_text(f'<VTKFile type="Collection" version="1.0"><Collection>{"".join(entries)}</Collection></VTKFile>')


if __name__ == "__main__":
    main(sys.argv[1])
