"""The documents as a site: `make docs`."""

project = "RichMap transfer benchmark"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["dollarmath", "fieldlist", "deflist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = project
exclude_patterns = ["README.md"]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
nitpicky = False
