"""The two bars in space, also with a hinge between them: `python studies/polyhedra/pictures.py FOLDER` writes frames, animations, pictures."""

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


def draw(axes, model, run, path, shapes):
    """Draw the outer faces in each (frame, colour), the time at the tip, and its path up to the last one, on axes of equal scale."""
    for k, colour in shapes:
        x = model.points + model.displacements(run.q[k])[model.number]
        faces = [x[start + face] for mesh, start in zip(model.meshes, model.starts) for face in mesh.outer]
        axes.add_collection3d(Poly3DCollection(faces, facecolors=colour, edgecolors="#222222", linewidths=0.2, shade=True))
        axes.text(*path[k] + (0.0, 0.0, -0.3 if k else 0.15), f"{run.t[k]:.2f} s", horizontalalignment="center")
    axes.plot(*path[: k + 1].T, color="#c44e52", linewidth=1.0)
    axes.set(xlim=(-1.8, 2.2), ylim=(-0.8, 1.2), zlim=(-1.9, 0.3), xlabel="x, m", ylabel="y, m", zlabel="z, m")
    axes.set_box_aspect((4.0, 2.0, 2.2), zoom=1.2)
    axes.locator_params(nbins=5)
    axes.view_init(18, -62)


def main(folder, hinge=False, cells=60, t_end=1.0):
    """Write bars.png, bars.gif, and run.pvd with the frames of both bars. hinge: between the bars."""
    (folder := Path(folder)).mkdir(parents=True, exist_ok=True)
    model, v0, tip = bars(cells, hinge=hinge)
    run = pi.solve(model, t_end, pi.EnergyMomentum(h=1e-3), v0=v0, every=20)
    path, blue = np.array([model.place(tip, q) for q in run.q]), np.array([0.55, 0.7, 1.0])
    axes = (fig := plt.figure(figsize=(8.0, 5.0))).add_axes((0.0, 0.0, 0.95, 1.0), projection="3d")
    draw(axes, model, run, path, [(k, blue * (1.0 - 0.5 * run.t[k] / t_end)) for k in np.linspace(0, len(run.t) - 1, 5).astype(int)])
    fig.savefig(folder / "bars.png", dpi=150)

    def frame(k):
        axes.clear()
        draw(axes, model, run, path, [(k, blue)])

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
    main(Path(sys.argv[1]) / "hinge", hinge=True)
