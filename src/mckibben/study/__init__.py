"""Whole pieces of work: scenario files, the paper end to end, tuning."""
