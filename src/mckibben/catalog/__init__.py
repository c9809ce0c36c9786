"""Published facts as files, one a publication, in the units of their source; each with `cite`.

>>> from mckibben import catalog
>>> catalog.names("laws")
['lei-mas-10-180n']
>>> print(catalog.cite("dmsp-10-250-martens2017"))
M. Martens and I. Boblan, "Modeling the Static Force of a Festo Pneumatic Muscle Actuator: ...
"""

from mckibben.catalog.entries import cite, dataset, geometry, joint, law, load, names, specimen

__all__ = ["cite", "dataset", "geometry", "joint", "law", "load", "names", "specimen"]
