"""How Sphinx builds the site: these pages, the notebooks with their stored outputs, and the API from docstrings.

`make docs` builds it into build/site, with every warning an error. Pages are read where they lie, so that a link works
here, on the site and in a checkout alike.
"""

import importlib.metadata
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project, author = "jaxtissue", "jaxtissue contributors"
release = importlib.metadata.version("jaxtissue")
copyright = author
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "site_parts"]

root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "notebooks/*.ipynb",
    "benchmarks/README.md",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
]
exclude_patterns = [".*", "build", "dist", "runs", "src", "tests"]

html_theme = "furo"
html_title = "jaxtissue"
html_math_renderer = "mathml"  # formulas need no script and no font of other hosts
html_copy_source = html_show_sourcelink = False
pygments_style = "friendly"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"
nb_merge_streams = True

default_role = "py:obj"  # names in docstrings stand in single backticks
autodoc_typehints = "none"  # shapes and types are told in words
autodoc_member_order = "bysource"
napoleon_attr_annotations = False
napoleon_use_ivar = True
napoleon_use_rtype = False
