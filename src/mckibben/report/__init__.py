"""Figures and the HTML report; the only place that imports matplotlib. Drawing takes numbers and returns figures.

Each function is loaded when it is first used: a figure imports what it draws, and nothing else.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
