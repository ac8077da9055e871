"""Minimum compliance by optimality criteria: SIMP with a filter of the densities, as in the published codes.

Source: Andreassen, Clausen, Schevenels, Lazarov, Sigmund, Struct. Multidisc. Optim. 43 (2011).
"""

import numpy as np

import polyida as pi

VOLUME, RADIUS, POWER, VOID = 0.5, 2.4, 3.0, 1e-9
MOVE, SETTLED = 0.2, 1e-2  # most that a density changes in an iteration, and below which it has settled


def optimised(mesh, compliance, iterations):
    """(densities, compliance of each iteration) from the uniform start; ends where no density changes by more than SETTLED."""
    blur, x, history = pi.mesh.density_filter(mesh, RADIUS), np.full(mesh.n_cells, VOLUME), []
    rates = blur.T @ mesh.cell_areas
    for _ in range(iterations):
        value, slope = compliance_at(compliance, blur @ x)
        history.append(value)
        before, x = x, update(x, blur.T @ slope, rates, VOLUME * mesh.area)
        if np.abs(x - before).max() <= SETTLED:
            break
    return blur @ x, history


def compliance_at(compliance, rho):
    """(compliance, its slopes in the densities) by SIMP."""
    stiffness, rate = pi.design.simp(rho, POWER, VOID)
    value, slope = compliance(stiffness)
    return value, slope * rate


def update(x, slope, rates, volume):
    """x times the root of -slope over multiplier times rates, held to MOVE and [0, 1]; the multiplier, by bisection, gives the volume.

    A linear filter with `rates = filter.T @ areas` keeps `rates @ x` the volume of the filtered densities.
    """
    low, high = 0.0, 1e9
    while high - low > 1e-10 * (high + low):
        multiplier = 0.5 * (low + high)
        scaled = x * np.sqrt(np.maximum(-slope, 0.0) / (rates * multiplier))
        new = np.clip(np.clip(scaled, x - MOVE, x + MOVE), 0.0, 1.0)
        low, high = (multiplier, high) if rates @ new > volume else (low, multiplier)
    return new
