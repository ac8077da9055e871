"""Designs in motion: slopes in the variables, equal masses, and that the optimiser helps."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from designed_in_motion import designs, solids
from designed_in_motion.machines import KEPT, MACHINES, VOLUME

ARM, ARMS = (replace(MACHINES[name], t_end=0.2) for name in ("arm", "two arms"))


@pytest.mark.parametrize("which", [ARM, ARMS], ids=["arm", "two arms"])
@pytest.mark.parametrize("kind", ["motion", "rest"])
def test_slopes_in_the_variables(which, kind):
    meshes = [which.mesh(40)] * len(which.names)
    rest = designs.at_rest(which, meshes, designs.LOADS["static, tip load and weight"])
    objective, case = designs.in_motion(which, meshes) if kind == "motion" else rest
    x = 0.6 + 0.3 * np.sin(np.arange(sum(mesh.n_cells for mesh in meshes)))
    way = np.cos(2.0 * np.arange(len(x)))
    problem, sharp = pi.design.Problem(objective, *designs.bounded(which, case, x)), pi.design.Sharpness(5.0, 4.0)
    ahead, behind = (problem.evaluate(x + s * way, sharp).values for s in (1e-4, -1e-4))
    assert problem.evaluate(x, sharp).slopes @ way == pytest.approx((ahead - behind) / 2e-4, rel=1e-3)


def test_solid_designs_have_equal_mass_and_whole_ends():
    mesh = ARM.mesh(200)
    rho = 1.0 * (np.abs(mesh.cell_centroids[:, 1]) > 0.06) + 1.0 * (mesh.cell_centroids[:, 0] > 0.8)
    (solid,) = solids.solid_meshes([mesh], rho, 0.5)
    for name in KEPT:
        assert solid.section(name).length == pytest.approx(mesh.section(name).length, rel=1e-12)
    thickness = solids.thickness_for(ARM, [solid], 0.45)
    assert solid.area * thickness == pytest.approx(0.45 * mesh.area * 0.01, rel=1e-12)
    assert solids.solid_meshes([mesh], 1.0 * (mesh.cell_centroids[:, 0] < 0.5), 0.5) is None


def test_material_placed_in_motion_helps():
    meshes = [ARM.mesh(60)]
    (design,) = designs.searched(*designs.in_motion(ARM, meshes), ARM, np.full(60, 0.35), [pi.design.Stage(10, 5.0)])
    rho, share = designs.densities_of(design), meshes[0].cell_areas / meshes[0].area
    assert design.met and design.objective < 0.2 * design.history["objective"][0]
    assert share @ rho <= 1.005 * VOLUME and (rho[~design.problem.maps[0].free] == 1.0).all()
