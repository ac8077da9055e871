"""Designs in motion: slopes in the variables, equal masses, and that the optimiser helps."""

from dataclasses import replace

import numpy as np
import pytest

from designed_in_motion import designs, optimiser, solids
from designed_in_motion.densities import Densities
from designed_in_motion.machines import KEPT, MACHINES

ARM, ARMS = (replace(MACHINES[name], t_end=0.2) for name in ("arm", "two arms"))


@pytest.mark.parametrize("which", [ARM, ARMS], ids=["arm", "two arms"])
@pytest.mark.parametrize("kind", ["motion", "rest"])
def test_slopes_in_the_variables(which, kind):
    meshes = [which.mesh(40)] * len(which.names)
    densities = Densities(which.names, meshes, 0.1)
    made = (
        designs.in_motion(which, meshes)
        if kind == "motion"
        else designs.at_rest(which, meshes, designs.LOADS["static, tip load and weight"])
    )
    x = 0.6 + 0.3 * np.sin(np.arange(len(densities.share)))
    way = np.cos(2.0 * np.arange(len(x)))

    def value(x):
        rho, rate = densities.of(x, 4.0)
        found, slopes = densities.evaluated(*made, rho, 5.0)
        return found, densities.blur.T @ (slopes * rate)

    (ahead, _), (behind, _) = value(x + 1e-4 * way), value(x - 1e-4 * way)
    assert value(x)[1] @ way == pytest.approx((ahead - behind) / 2e-4, rel=1e-3)


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
    densities = Densities(ARM.names, [ARM.mesh(60)], 0.05)
    x = np.full(60, 0.35)
    value = designs.compiled(densities, x, *designs.in_motion(ARM, [ARM.mesh(60)]))
    _, (rho,), history, reached = optimiser.minimised(densities, value, ((5.0, None, 10),), x)
    assert value(rho, 5.0)[0] == pytest.approx(reached, rel=1e-9) and reached < 0.2 * history[0]
    assert densities.share @ rho <= optimiser.VOLUME + 1e-6 and (rho[~densities.free] == 1.0).all()
