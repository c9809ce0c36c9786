"""The QR factors of tall matrices, by blocks of rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Numbers in a block: so few that OpenBLAS does not wake threads, which beside XLA cost 100 times the work.
_BLOCK = 6144


def tall_qr(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Orthonormal columns Q, shape (n, k), and the triangle R, shape (k, k), with Q R = `matrix`; n >= k.

    As stable as the ordinary factorisation: blocks of rows are factored each, then their stacked triangles.

    References
    ----------
    J. Demmel et al., "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci.
    Comput. 34 (2012) A206-A239.

    Examples
    --------
    >>> matrix = np.vander(np.linspace(0, 1, 5000), 6)
    >>> q, r = tall_qr(matrix)
    >>> bool(np.allclose(q @ r, matrix)), bool(np.allclose(q.T @ q, np.eye(6)))
    (True, True)
    """
    count, width = matrix.shape
    rows = max(_BLOCK // max(width, 1), 2 * width)
    if count <= rows:
        return np.linalg.qr(matrix)
    blocks = -(-count // rows)
    padded = np.zeros((blocks * rows, width))
    padded[:count] = matrix
    inner, triangles = np.linalg.qr(padded.reshape(blocks, rows, width))
    outer, triangle = tall_qr(triangles.reshape(blocks * width, width))
    basis = inner @ outer.reshape(blocks, width, width)
    return basis.reshape(-1, width)[:count], triangle
