"""Sphinx configuration of the documentation: `make docs`. The site loads nothing from other hosts."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

import mckibben
from mckibben.export import export

mpl.use("agg")
sys.path.insert(0, str(Path(__file__).parent))  # sphinx-gallery imports the scraper by name

KNEE = Path(__file__).parents[1] / "examples" / "pre-contracted-step-pid.yaml"

project = "mckibben"
author = "The mckibben contributors"
copyright = f"2026, {author}"
version = release = mckibben.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "README.md",
    "_build",
    "gallery/**/*.ipynb",
    "gallery/**/*.py",
    "gallery/**/*.zip",
    "gallery/**/*.json",
]
default_role = "py:obj"  # names in docstrings; non-public ones stay plain text

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
myst_url_schemes = ("http", "https", "mailto")
suppress_warnings = ["config.cache", "ref.python"]  # the functions below; names of attributes that several classes have

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types, shapes and units
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False  # parameters that are documented together stay together
napoleon_use_ivar = True
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

templates_path = ["_templates"]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = "mckibben"
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {"top_of_page_buttons": []}

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"plot_",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("gallery_scraper.scrape",),
    "reset_modules": (),
    "capture_repr": ("_repr_html_", "__repr__"),
    "ignore_repr_types": r"Figure|Path",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 0,
    "abort_on_example_error": True,
    "write_computation_times": False,
}


def _mathml(node: Any, block: bool) -> str:
    return tex2mathml(
        re.sub(r"\\[bB]igg?(?![a-z])", "", node.astext()), as_block=block
    )  # size commands, which MathML does not need


def _inline_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node, block=False))
    raise nodes.SkipNode


def _block_math(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{_mathml(node, block=True)}</div>')
    raise nodes.SkipNode


def _write_page(app: Sphinx, error: Exception | None) -> None:
    """The knee of the first page, to move."""
    if error is None and app.builder.name == "html":
        export(mckibben.Scenario.read(KNEE), "page", Path(app.outdir) / "live", name="knee", overwrite=True)


def _link_page(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: nodes.document | None) -> None:
    if page == "index":
        head, image, following = context["body"].partition("knee.webp")
        picture, end, rest = following.partition("</p>")
        link = '<p><a href="live/knee.html">Move this knee yourself</a>, in your browser.</p>'
        context["body"] = head + image + picture + end + link + rest


def setup(app: Sphinx) -> None:
    """Render formulas as MathML, which needs no scripts; add the page of a knee."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    app.connect("html-page-context", _link_page)
    app.connect("build-finished", _write_page)
