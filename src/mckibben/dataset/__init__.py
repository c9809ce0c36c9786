"""Measured points of isobaric tests: the container, its files, and a reader for the files of others."""

from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.reading import read_dataset

__all__ = ["IsobaricDataset", "read_dataset"]
