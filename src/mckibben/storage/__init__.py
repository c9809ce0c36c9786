"""Durable files: atomic writes, locks, append-only journals, and signal handling for long jobs."""
