"""Interface to XLA: precision and flags, fast elementary functions, fixed-step integration."""
