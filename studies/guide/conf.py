"""Sphinx's settings of the guide: `python -m sphinx -W --keep-going -b html studies/guide OUT` builds it, without a network."""

import sys
from pathlib import Path
from typing import TypeVar

import numpy.typing

import polyida

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))


def import_all():
    """Import what the API shows, with numpy's types by their names: signatures would show all that these are made of."""
    types = {name: getattr(numpy.typing, name) for name in ("ArrayLike", "NDArray")}
    for name in types:
        setattr(numpy.typing, name, TypeVar(name))
    for place in (polyida, polyida.study):
        for name in place.__all__:
            getattr(place, name)
    for name, known in types.items():
        setattr(numpy.typing, name, known)


import_all()

project = "polyida"
author = copyright = "polyida developers"
release = version = polyida.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "rendering.mathml",
    "rendering.docstrings",
]
suppress_warnings = ["ref.python"]  # names in tables of attributes, such as x, become links, and several classes have an x
exclude_patterns = ["examples", "rendering"]
smartquotes = False  # texts are code more often than speech
html_theme = "furo"
html_title = "polyida"
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["guide.css"]
html_math_renderer = "mathml"
pygments_dark_style = "github-dark"
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3
myst_url_schemes = ["http", "https"]
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
sphinx_gallery_conf = {
    "examples_dirs": [str(HERE / "examples")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",  # all of them are run
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "write_computation_times": False,
    "show_signature": False,
    "capture_repr": (),  # what a line gives is not shown, what it prints is
    "remove_config_comments": True,
    "image_srcset": ["2x"],
    "thumbnail_size": (640, 448),  # twice as many pixels as are shown
    "reset_modules": ("matplotlib", "rendering.gallery_style.use_style"),
}
