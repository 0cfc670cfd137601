"""The manual: ``python -m sphinx -W -b html docs docs/_build/html`` (extra ``docs``)."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]
os.environ.setdefault("MPLBACKEND", "Agg")
for chatty in ("fontTools", "matplotlib.category"):  # each glyph of a PDF, each axis of points' names
    logging.getLogger(chatty).setLevel(logging.WARNING)

import forearm_fem  # noqa: E402

project = "forearm_fem"
author = "the forearm_fem authors"
copyright = "2026, the forearm_fem authors"
release = version = forearm_fem.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx.ext.viewcode",
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "places",
    "public_api",
    "scenario_keys",
    "command_pages",
    "quick_run",
]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
exclude_patterns = ["_build", "gallery", "tutorials/*.py", "tutorials/GALLERY_HEADER.rst"]
nitpicky = False
smartquotes = False  # they make a dash of --set and curl the quotes of what is meant to be copied into a shell

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "fieldlist", "attrs_block"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

mathjax_path = "mathjax/tex-chtml.js"  # beside the pages: the manual is read without a network, too

autodoc_typehints = "none"  # signatures name the types; doubled lists of them hide the sentences
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True  # a default that is a table is named, not printed
toc_object_entries = False  # else each page carries a tree of all objects: two thirds of the build
autodoc_mock_imports = ["nvmath", "cupy"]
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

sphinx_gallery_conf = {
    "examples_dirs": [str(HERE / "tutorials"), str(HERE / "gallery")],
    "gallery_dirs": ["made/tutorials", "made/gallery"],
    "filename_pattern": r"[\\/]\d\d_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "min_reported_time": 1,
    "image_scrapers": ("own_figures.scraper",),
    "ignore_repr_types": r"matplotlib",
    "abort_on_example_error": True,
    "show_memory": False,
    "write_computation_times": False,
    "reset_modules": (),
    "copyfile_regex": r".*\.toml",
}
suppress_warnings = ["config.cache"]

highlight_language = "text"  # blocks without a language are command lines
html_theme = "furo"
html_title = f"forearm_fem {release}"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_search_scorer = str(HERE / "_static" / "search_scorer.js")  # who looks for "spacing" has a question
html_show_sphinx = False
html_copy_source = False
templates_path: list[str] = []
