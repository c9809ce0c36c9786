"""Code generation: JAX functions as C99 and JavaScript programs, emitted from their jaxprs."""

from mckibben.codegen.c import write_c
from mckibben.codegen.javascript import write_js
from mckibben.codegen.source_module import SourceModule

__all__ = ["SourceModule", "write_c", "write_js"]
