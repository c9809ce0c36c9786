"""mckibben: pneumatic artificial muscles, from the test rig to a controlled joint.

Importing has one documented effect: JAX computes with 64-bit numbers (and its loops run fast on the CPU, see
`mckibben.numerics.runtime`). The public names are in `__init__.pyi`; each is loaded when it is first used, so that the
import itself is quick.
"""

import lazy_loader

from mckibben.numerics import runtime as _runtime

__version__ = "0.1.0"

_runtime.configure()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
