"""Configuration of the site, which `sphinx-build -W --keep-going docs docs/_build` builds with
warnings as errors."""

import sys
import urllib.request
from pathlib import Path

import jax
import numpy.typing

sys.path.insert(0, str(Path(__file__).parent))

# Types are printed by the names of their aliases, not as the unions that the aliases stand for.
for typed in (numpy.typing, jax.typing):
    typed.ArrayLike = type("ArrayLike", (), {"__module__": typed.__name__})

import jaxvision  # noqa: E402  (after the names that its annotations use)

project = "jaxvision"
author = "The jaxvision developers"
copyright = author
version = release = jaxvision.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx_design",
    "site_pages",
]
exclude_patterns = ["_build", "jupyter_execute", "how-to/_*.md"]  # included by pages
myst_enable_extensions = ["colon_fence", "html_image"]
myst_heading_anchors = 3
suppress_warnings = ["ref.python"]  # a name quoted in an annotation, of two modules
nb_execution_mode = "off"  # CI executes the notebooks; their stored results are shown

default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
python_maximum_signature_line_length = 88
napoleon_use_ivar = True
napoleon_custom_sections = ["Source"]


def reachable(address: str) -> bool:
    try:
        with urllib.request.urlopen(address + "objects.inv", timeout=5):
            return True
    except OSError:
        return False


intersphinx_mapping = {  # empty without a network: the build needs none
    "python": ("https://docs.python.org/3/", None),
    "numpy": ("https://numpy.org/doc/stable/", None),
    "jax": ("https://docs.jax.dev/en/latest/", None),
}
if not all(reachable(address) for address, _ in intersphinx_mapping.values()):
    intersphinx_mapping = {}

# Pages with wide tables, which omit the list of contents to have more width.
TABLES = ("errors", "coverage", "comparison", "effects", "foreign_inputs", "speed")

html_theme = "pydata_sphinx_theme"
html_title = f"jaxvision {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/ball.svg"
html_context = {"default_mode": "auto"}  # light or dark, as the reader's system
html_show_sourcelink = False
html_theme_options = {
    "logo": {
        "text": "jaxvision",
        "image_light": "_static/ball.svg",
        "image_dark": "_static/ball.svg",
    },
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": {"**": ["page-toc"], **dict.fromkeys(TABLES, ())},
    "header_links_before_dropdown": 8,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": [], "install": [], "tutorial": []}  # pages that have no subpages
