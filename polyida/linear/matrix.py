"""A matrix as the plain array that small systems are solved with."""

import numpy as np


def dense(matrix):
    """The matrix, dense or scipy.sparse, as a dense array of floats."""
    return matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, float)
