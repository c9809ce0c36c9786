"""Functions of the project as programs in C99 and JavaScript, emitted from their jaxprs."""

from mckibben.codegen.c import write_c
from mckibben.codegen.program import Program

__all__ = ["Program", "write_c"]
