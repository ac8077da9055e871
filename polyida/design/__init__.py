"""Topology optimisation on polygons: from densities to factors of stiffness and mass, and from a design to a solid mesh.

`rho = pi.mesh.density_filter(mesh, radius) @ x` are densities in [0, 1], one a cell; `ramp`, `simp` and `mass` make of them the factors
that `model.with_factors(plate=(stiffness, mass))` takes, `project` drives them to 0 and 1, `threshold` is the end of it. Each function of
rho gives its value and its slope, so that by the chain rule `dJ/drho = dJ/dstiffness * slope of stiffness + dJ/dmass * slope of mass`.
"""

from polyida.design.densities import mass, project, ramp, simp, threshold

__all__ = ["mass", "project", "ramp", "simp", "threshold"]
