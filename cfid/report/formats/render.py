"""Render a report in the format of a file's suffix."""

import json
from pathlib import Path
from typing import Literal

from cfid.console.messages import printable_lines
from cfid.report.content import Report
from cfid.report.formats.html import as_html
from cfid.report.formats.markdown import as_markdown
from cfid.report.formats.sealed import MARK
from cfid.report.formats.tex import as_tex

Format = Literal["html", "md", "json", "tex"]


def rendered(report: Report, form: Format, folder: Path) -> str:
    """Return a report's text; figures are read from `folder`, the campaign's.

    Characters that a terminal would obey become question marks, or escapes in JSON.
    """
    if form == "html":
        return printable_lines(as_html(report, folder))
    if form == "md":
        return printable_lines(as_markdown(report))
    if form == "tex":
        return printable_lines(as_tex(report))
    return json.dumps({"made_by": MARK, **report.as_json()}, indent=1, allow_nan=False) + "\n"
