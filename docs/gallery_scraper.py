"""Images of the gallery: the figures that a block of an example has made."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Write the new figures among the variables of an example, in the order of their names' appearance."""
    seen: set[int] = block_vars.setdefault("drawn_figures", set())
    names = []
    found = [value for value in block_vars["example_globals"].values() if isinstance(value, Figure)]
    for figure in {id(each): each for each in found}.values():
        if id(figure) not in seen:
            seen.add(id(figure))
            names.append(str(next(block_vars["image_path_iterator"])))
            figure.savefig(names[-1], dpi=150)
    return figure_rst(names, gallery_conf["src_dir"])
