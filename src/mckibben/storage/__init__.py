"""Durable files: atomic writes, locks, append-only journals, and signals during a long job."""
