"""Templates of programs, whose marks are none of C, JavaScript, Python and XML."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jinja2


@functools.cache
def _environment(package: str) -> jinja2.Environment:
    import jinja2  # only here: a program from the cache needs none

    return jinja2.Environment(
        *("<%", "%>", "${", "}", "<#", "#>"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.PackageLoader(package),
    )


def filled(template: str, values: Mapping[str, object], package: str = "mckibben.codegen") -> str:
    """Text of a template in the folder ``templates`` of a package, with `values` in place of ``${name}``.

    Raises `jinja2.UndefinedError` for a value that is missing.

    Examples
    --------
    >>> print(filled("module.js", {"comment": ["a spring"], "name": "spring", "helpers": [], "structures": [],
    ...                            "prepare": [], "functions": []}).splitlines()[1])
    const spring = (function () {
    """
    return _environment(package).get_template(template).render(values)
