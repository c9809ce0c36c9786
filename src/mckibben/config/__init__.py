"""Configuration files: YAML with line numbers, models, field types and diagnostics."""
