"""How Sphinx builds the site; `python -m docs` stages its pages and calls it."""

from importlib.metadata import version as installed

project = "loadid"
author = "The loadid developers"
copyright = "2026, The loadid developers"
version = release = installed("loadid")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "docs.making.formulas", "docs.making.links",
              "docs.making.sentences"]  # fmt: skip
exclude_patterns = ["making", "gallery/*.json", "**/__pycache__"]
default_role = "name"
language = "en"
nitpicky = False

myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline", "attrs_block", "deflist"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
add_module_names = False
toc_object_entries = False
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_preprocess_types = False
napoleon_use_param = False
napoleon_custom_sections = [("Attributes", "params_style")]

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "loadid"
html_context = {"default_mode": "auto"}
html_static_path = ["static"]
html_css_files = ["site.css"]
html_sidebars = {"choosing": []}  # a page without others beside it
html_copy_source = False
html_show_sourcelink = False
html_favicon = "static/favicon.svg"
pygments_style = "a11y-high-contrast-light"
html_theme_options = {
    "logo": {"text": "loadid"},
    "navbar_end": ["theme-switcher"],
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
