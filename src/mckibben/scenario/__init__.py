"""Scenario files: one run of a controller on a joint; parameters of scenarios by name.

Each name is loaded when it is first used: files of muscles need no controllers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
