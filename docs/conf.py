"""Sphinx configuration: ``make docs``."""

project = 'lpv-arm-fdi'
copyright = 'lpv-arm-fdi maintainers'
version = release = '0.1.0'

extensions = ['sphinx.ext.autodoc', 'sphinx.ext.autosummary', 'numpydoc', 'myst_parser']
source_suffix = {'.md': 'markdown', '.rst': 'restructuredtext'}
exclude_patterns = ['_build']
html_theme = 'furo'
html_title = 'lpv-arm-fdi'

autosummary_generate = True
autodoc_member_order = 'bysource'
# Records and enums would list the members that they inherit from NumPy.
numpydoc_show_inherited_class_members = False
numpydoc_class_members_toctree = False
# GitHub's way of headings as link targets.
myst_heading_anchors = 4
myst_enable_extensions = ['colon_fence']
# Pages link to folders and files of the repository, which are not part of the site.
suppress_warnings = ['myst.xref_missing']
