"""Save a figure as PNG and SVG files, atomically, and never over a file of another origin."""

import io
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.figure import Figure

from cfid.drawing.style import styled
from cfid.errors import ConfigError
from cfid.records.files import check_regular, refuse_kept, write_whole
from cfid.version import __version__

PNG_DPI = 150

_MAKER = "cfid"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEAD_BYTES = 4096  # both formats name their creator near the start
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
    maker = f"{_MAKER} {__version__}"
    with _laid_out(figure):
        contents = {
            stem.with_name(stem.name + ".png"): _rendered(figure, "png", {"Software": maker}),
            stem.with_name(stem.name + ".svg"): _rendered(figure, "svg", {"Creator": maker, "Date": None}),
        }
    try:
        _refuse_foreign(contents, force=force)
        stem.parent.mkdir(parents=True, exist_ok=True)
        for path, content in contents.items():
            write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{stem}.png: no figure can be written there: {error.strerror}.") from None
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


def _rendered(figure: Figure, kind: str, metadata: dict[str, str | None]) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format=kind, dpi=PNG_DPI, metadata=metadata)
    return content.getvalue()


def _refuse_foreign(paths: Iterable[Path], *, force: bool) -> None:
    for path in paths:
        if path.exists() and _made_by_cfid(path):
            continue
        refuse_kept(path)
        if path.exists() and not force:
            raise ConfigError(
                f"{path}: exists already and cfid did not draw it. "
                "Use `force` to replace it, or `out` to write elsewhere."
            )


def _made_by_cfid(path: Path) -> bool:
    check_regular(path)
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(_PNG_SIGNATURE):
        return _png_text(head, b"Software").startswith(f"{_MAKER} ".encode())
    return _OUR_SVG.match(head) is not None


def _png_text(head: bytes, keyword: bytes) -> bytes:
    """Return a PNG's text with this keyword, else b""; chunks consist of length, kind, content and checksum."""
    at = len(_PNG_SIGNATURE)
    while at + 8 <= len(head):
        length, kind = struct.unpack_from(">I4s", head, at)
        name, _, text = head[at + 8 : at + 8 + length].partition(b"\0")
        if kind == b"tEXt" and name == keyword:
            return text
        at += length + 12
    return b""
