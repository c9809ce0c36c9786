"""Numerics below all physics: elementary functions, derivatives, roots and integration steps; programs and their cache.

Functions are pure and written in JAX. `compiled` compiles a function once per structure of its arguments, `batching`
names and replaces the leaves of trees and computes batches in chunks, `program_cache` keeps programs on disk, and
`runtime` sets up JAX before its first use.
"""
