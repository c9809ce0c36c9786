"""The triangular factor of tall matrices, by blocks of rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Numbers in a block: so few that OpenBLAS does not wake threads, which beside XLA cost 100 times the work.
_BLOCK = 6144


def triangle(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """R of the QR factors, shape (k, k), of a matrix of shape (n, k), n >= k; fastest where columns are contiguous.

    As stable as the ordinary factorisation: blocks of rows are factored each, then their stacked triangles. Q is never
    needed: R of the columns [A, y] tells the least squares of A x = y, their residual, and the condition of A.

    References
    ----------
    J. Demmel et al., "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci.
    Comput. 34 (2012) A206-A239.

    Examples
    --------
    >>> matrix = np.vander(np.linspace(0, 1, 5000), 6)
    >>> r = triangle(matrix)
    >>> bool(np.allclose(r.T @ r, matrix.T @ matrix)), bool(np.all(np.tril(r, -1) == 0))
    (True, True)
    """
    count, width = matrix.shape
    most = max(_BLOCK // max(width, 1), 2 * width)
    if count <= most:
        return np.asarray(np.linalg.qr(matrix, mode="r"))
    blocks = -(-count // most)
    rows = -(-count // blocks)
    if blocks * rows > count:
        matrix = np.concatenate([matrix, np.zeros((blocks * rows - count, width))])
    triangles = np.asarray(np.linalg.qr(matrix.reshape(blocks, rows, width), mode="r"))
    return triangle(triangles.reshape(blocks * width, width))
