"""Reachability: static envelope, feasibility of a reference and sizing of a joint."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # sizes alone need data and identification
