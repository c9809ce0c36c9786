"""Identification of force laws and friction from measured points: least squares, uncertainty, cross-validation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # a file's law needs few
