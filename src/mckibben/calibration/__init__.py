"""Calibration: identification of a joint model from recordings of the joint's motion."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # valves need no joint
