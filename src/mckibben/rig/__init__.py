"""The test rig: protocols, runner, recorder and safety monitor; simulated rig and NI cards."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
