"""How Sphinx makes the documentation: python -m sphinx -W -b html docs docs/_build"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

from clcache.version import __version__  # noqa: E402

project = "clcache"
author = "the clcache authors"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "clcache_docs"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
default_role = "literal"
smartquotes = False  # which make dashes of options
nitpicky = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"clcache {__version__}"
html_static_path = ["_static"]
html_css_files = ["clcache.css"]
html_show_copyright = False
