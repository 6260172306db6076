"""Settings of the documentation site; `make docs` builds it."""

import os
import sys
from pathlib import Path

SITE = Path(__file__).resolve().parent
sys.path[:0] = [str(SITE), str(SITE.parents[1])]
os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # of what tutorials run

project = "dvc3d"
copyright = "the dvc3d authors"
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "chapters",
    "commands",
    "links",
    "reference",
    "sources",
]
exclude_patterns = ["site"]
root_doc = "index"
source_suffix = {".md": "myst-nb"}

html_theme = "pydata_sphinx_theme"
html_title = "dvc3d"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # is fetched, which browsers refuse to pages of files
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "header_links_before_dropdown": 8,
    "show_nav_level": 1,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_context = {"default_mode": "auto"}
highlight_language = "none"
pygments_style = "default"

myst_heading_anchors = 4
myst_links_external_new_tab = False

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
