import numpy as np
import pytest
from scipy.sparse import block_diag, bsr_array, coo_array, csr_array, eye_array, kron

from polyida.jit.intrinsics import COLUMNS
from polyida.linear.columns import solve_columns
from polyida.linear.dissection import LEAF, symbolic
from polyida.linear.fronts import factorize, solve_fronts
from polyida.linear.lu import SingularSystem


def grid(nx, ny):
    """Nodes of a grid, each joined to its eight neighbours: (pattern matrix, points)."""
    line = [csr_array(np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) for n in (nx, ny)]
    x, y = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    return csr_array(kron(*line)), np.column_stack([x.ravel(), y.ravel()]).astype(float)


def scattered(count, edges, seed):
    rng = np.random.default_rng(seed)
    i, j = rng.integers(count, size=(2, edges))
    half = coo_array((np.ones(edges), (i, j)), shape=(count, count))
    return csr_array(half + half.T + eye_array(count)), rng.random((count, 2))


def side_by_side(*parts):
    return csr_array(block_diag([p[0] for p in parts])), np.vstack([p[1] for p in parts])


def spd_blocks(pattern, seed=0):
    """Symmetric blocks on the pattern, made positive definite by their diagonal."""
    rng = np.random.default_rng(seed)
    blocks = rng.standard_normal((pattern.nnz, 2, 2))
    full = bsr_array((blocks, pattern.indices, pattern.indptr)).tocsr()
    full = csr_array(full + full.T)
    full = full + csr_array(np.diag(1.0 + abs(full).sum(axis=1)))
    full = bsr_array(full, blocksize=(2, 2))
    full.sort_indices()
    assert np.array_equal(full.indices, pattern.indices)
    return full.data, full.tocsr()


def solved(s, panels, b):
    x = np.zeros(len(b) + 5, panels.dtype)
    x[s.order] = b
    solve_fronts(s, panels, x)
    assert not x[len(b) :].any()
    return x[s.order].astype(np.result_type(x, float))


CASES = {
    "one node": grid(1, 1),
    "a leaf": grid(3, 4),
    "a row": grid(1, 200),
    "a plate": grid(40, 9),
    "a square": grid(20, 20),
    "two plates": side_by_side(grid(30, 6), grid(25, 7)),
    "many small bodies": side_by_side(*(grid(1 + k % 4, 2) for k in range(40))),
    "scattered": scattered(150, 200, 1),
    "dense": (csr_array(np.ones((3 * LEAF, 3 * LEAF))), np.zeros((3 * LEAF, 2))),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["positive", "negative"])
def test_solution_is_that_of_the_matrix(name, sign):
    pattern, points = CASES[name]
    pattern.sort_indices()
    blocks, matrix = spd_blocks(pattern)
    s = symbolic(pattern.indptr, pattern.indices, points)
    panels = factorize(s, sign * blocks)
    x = np.random.default_rng(2).standard_normal(matrix.shape[0])
    assert np.linalg.norm(solved(s, panels, sign * (matrix @ x)) - x) < 3e-6 * np.linalg.norm(x)


@pytest.mark.parametrize("name", CASES)
def test_columns_are_solved_as_one_right_hand_side_is(name):
    pattern, points = CASES[name]
    pattern.sort_indices()
    blocks, matrix = spd_blocks(pattern)
    s = symbolic(pattern.indptr, pattern.indices, points)
    panels, x = factorize(s, blocks), np.random.default_rng(2).standard_normal((matrix.shape[0], COLUMNS))
    x[:, 1] *= 1e6
    x[:, 2] = 0.0
    b = np.zeros(x.shape, np.float32)
    b[s.order] = matrix @ x
    solve_columns(s, panels, b)
    for column, result in zip(x.T, b[s.order].T):
        assert np.linalg.norm(result - column) <= 3e-6 * np.linalg.norm(column)


@pytest.mark.parametrize("name", CASES)
def test_a_complex_matrix_is_symmetric_and_not_hermitian(name):
    pattern, points = CASES[name]
    pattern.sort_indices()
    (K, stiff), (M, mass) = spd_blocks(pattern), spd_blocks(pattern, 5)
    c2, random = -2.0 + 16.0j, np.random.default_rng(2)  # K alone is positive definite, c2 M is not
    s, x = symbolic(pattern.indptr, pattern.indices, points), random.standard_normal((2, pattern.shape[0] * 2)).T @ (1.0, 1.0j)
    panels = factorize(s, K + c2 * M)
    assert panels.dtype == np.complex64
    assert np.linalg.norm(solved(s, panels, (stiff + c2 * mass) @ x) - x) < 3e-6 * np.linalg.norm(x)


@pytest.mark.parametrize("spoil", ["singular", "not a number"])
def test_no_factor_of_a_singular_matrix(spoil):
    pattern, points = grid(20, 8)
    blocks, _ = spd_blocks(pattern)
    s = symbolic(pattern.indptr, pattern.indices, points)
    at = pattern.indptr[77] + np.flatnonzero(pattern.indices[pattern.indptr[77] : pattern.indptr[78]] == 77)[0]
    if spoil == "singular":
        blocks[:] = 0.0
    else:
        blocks[at, 0, 0] = np.nan
    with pytest.raises(SingularSystem):
        factorize(s, blocks)
