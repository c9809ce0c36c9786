"""Code generation: JAX functions as programs in C99, CUDA and JavaScript.

A function is traced to a jaxpr, lowered to scalar expressions in nested scopes (`lowering`, `graph`) and written in a
language (`writer` and its subclasses). There are two kinds of programs: a module of functions with parameters and a
state (`SourceModule`), which is exported as source text, and a function of arrays, which is compiled and called on this
machine (`native` for one run or many in vector registers, `cuda` for many on a GPU).
"""

from mckibben.codegen.c import write_c
from mckibben.codegen.javascript import write_js
from mckibben.codegen.source_module import SourceModule

__all__ = ["SourceModule", "write_c", "write_js"]
