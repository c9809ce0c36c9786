"""All that knows about XLA: precision and flags, fast elementary functions, fixed-step integration."""
