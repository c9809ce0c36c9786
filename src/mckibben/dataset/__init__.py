"""Measurements: isobaric datasets, raw recordings, and readers of laboratory files."""

from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.points import ExtractedPoints
from mckibben.dataset.reading import read_dataset, read_recording
from mckibben.dataset.recording import Recording

__all__ = ["ExtractedPoints", "IsobaricDataset", "Recording", "read_dataset", "read_recording"]
