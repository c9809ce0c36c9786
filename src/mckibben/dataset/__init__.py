"""Measurements: isobaric datasets, raw recordings, and readers of laboratory files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the readers' process needs little
