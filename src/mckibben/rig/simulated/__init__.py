"""Simulated rig behind the interface of a physical one, with its faults."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # a joint rig needs the faults alone
