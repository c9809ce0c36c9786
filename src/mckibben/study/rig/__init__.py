"""Tests on a rig, from a protocol file to the dataset that `identify` reads."""
