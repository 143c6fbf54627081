"""Save a figure as PNG and SVG files, atomically, and never over a file of another origin."""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from cfid.drawing.style import styled
from cfid.records.files import check_regular, write_files
from cfid.version import __version__

PNG_DPI = 150

# matplotlib's own prologue: a drawing program that edits our SVG keeps the creator's name but not these lines, and
# the file is then somebody's work.
_OUR_SVG = re.compile(
    rb'\A<\?xml version="1\.0" encoding="utf-8" standalone="no"\?>\s*<!DOCTYPE svg [^>]*>\s*<svg [^>]*>\s*'
    rb"<metadata>.*?<dc:creator>\s*<cc:Agent>\s*<dc:title>cfid ",
    re.DOTALL,
)


@styled
def save_figure(figure: Figure, stem: Path, *, force: bool = False) -> list[Path]:
    """Write `<stem>.png` and `<stem>.svg` and return their paths; equal figures yield equal files.

    Earlier figures of cfid are replaced. Both files are rendered and checked before either is written.

    Raises ConfigError when a file of that name was not written by cfid and `force` is not set, when it belongs to a
    run, or when the folder cannot be written.
    """
    maker, contents = f"cfid {__version__}", dict[Path, bytes]()
    with _laid_out(figure):
        for kind, metadata in (("png", {"Software": maker}), ("svg", {"Creator": maker, "Date": None})):
            content = io.BytesIO()
            figure.savefig(content, format=kind, dpi=PNG_DPI, metadata=metadata)
            contents[stem.with_name(f"{stem.name}.{kind}")] = content.getvalue()
    write_files(contents, force=force, is_replaceable=_made_by_cfid)
    return list(contents)


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Lay out a figure once for all files; matplotlib would do so for each, which takes longer than drawing it."""
    layout, dpi = figure.get_layout_engine(), figure.dpi
    figure.dpi = PNG_DPI
    if layout is not None:
        for _ in range(2):  # the first pass may change the ticks
            layout.execute(figure)
    figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(layout)
        figure.dpi = dpi


def _made_by_cfid(path: Path) -> bool:
    check_regular(path)
    if path.suffix == ".svg":
        with path.open("rb") as file:
            return _OUR_SVG.match(file.read(4096)) is not None
    try:
        with Image.open(path, formats=["PNG"]) as image:
            return str(image.info.get("Software", "")).startswith("cfid ")
    except (OSError, SyntaxError):  # no image, or a damaged one
        return False
