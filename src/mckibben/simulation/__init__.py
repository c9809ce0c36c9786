"""The sampled-data loop, its result and metrics, and the static feasibility of a reference."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
