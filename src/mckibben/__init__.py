"""mckibben: pneumatic artificial muscles, from the test rig to a controlled joint.

Importing has one documented effect: JAX computes with 64-bit numbers (and its loops run fast on the CPU, see
`mckibben.numerics.runtime`). The public names are listed here one by one; each is loaded when it is first used.
"""

from __future__ import annotations

__version__ = "0.1.0"

from mckibben.numerics import runtime as _runtime

_runtime.configure()
