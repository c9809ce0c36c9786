"""Durable files: atomic writes, locks, studies in SQLite, and signal handling for long jobs."""
