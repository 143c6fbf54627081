"""A report as HTML, Markdown, TeX and JSON."""
