"""The density filter: identities of its weights."""

import numpy as np
import pytest

import polyida as pi

MESH = pi.mesh.rectangle(1.0, 0.25, cells=100, seed=1)


def test_weights_are_hats_times_areas():
    radius = 0.06
    hats = np.maximum(0.0, radius - np.linalg.norm(MESH.cell_centroids[:, None] - MESH.cell_centroids, axis=2)) * MESH.cell_areas
    assert np.allclose(pi.mesh.density_filter(MESH, radius).toarray(), hats / hats.sum(axis=1, keepdims=True), rtol=1e-12, atol=1e-15)


def test_constants_stay_and_a_linear_field_far_from_the_rim():
    blur = pi.mesh.density_filter(MESH, radius=0.08)
    assert blur @ np.ones(MESH.n_cells) == pytest.approx(1.0, rel=1e-14)
    quads = pi.mesh.quads(1.0, 0.5, 20, 10)
    inside = (np.abs(quads.cell_centroids[:, 0] - 0.5) < 0.35) & (np.abs(quads.cell_centroids[:, 1]) < 0.1)
    x = quads.cell_centroids[:, 0]
    assert (pi.mesh.density_filter(quads, radius=0.12) @ x)[inside] == pytest.approx(x[inside], rel=1e-12)
