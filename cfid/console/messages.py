"""Print notes and errors to stderr, in colour unless NO_COLOR is set."""

import contextlib
import errno
import json
import os
import re
import stat
import sys
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import typer

_HEAD = len("note: ")  # as long as `cfid: `, so that later lines are aligned with the text
_SETTING = re.compile(r"`([a-z]\w*)`")
# Every other option is its setting's name with hyphens.
_RENAMED = {
    "arm_m": "--arm-mm",
    "dshot": "--esc-us",
    "folder": "--campaign",
    "from_s": "--from",
    "rotor": "--motor",
    "to_s": "--to",
}


def in_options(text: str) -> str:
    """Return a message with its settings, which are in backticks, replaced by options: `rate_hz` becomes --rate-hz.

    Messages name settings because Python users, who have no options, see them too. Text that a message quotes from
    files and devices is made printable.
    """
    return _SETTING.sub(lambda match: _RENAMED.get(match[1], f"--{match[1].replace('_', '-')}"), printable_lines(text))


def printable(text: str) -> str:
    """Return a text on one line; a character that a terminal might obey instead of showing it becomes ?."""
    return printable_lines(text).replace("\n", " ")


def printable_lines(text: str) -> str:
    """Return a text that `printable` would return, but with its line breaks."""
    return "".join(letter if letter.isprintable() or letter == "\n" else "?" for letter in text.replace("\t", " "))


def echo(text: object = "", *, nl: bool = True, err: bool = False) -> None:
    """Print lines to stdout or stderr, made printable since they may contain text of others, such as a path.

    Lines for a closed terminal are dropped, since nobody can read them. Where stderr cannot be written, as on a full
    disk, the command continues without it, since results go elsewhere. Raises OSError where any other stdout cannot be
    written.
    """
    try:
        typer.echo(printable_lines(str(text)), nl=nl, err=err)
    except OSError as error:
        closed = error.errno == errno.EIO and stat.S_ISCHR(os.fstat(sys.stdout.fileno()).st_mode)
        if not (err or closed):
            raise
        drop_unwritable()


def print_json(content: Mapping[str, Any]) -> None:
    """Print the one object of --json; arrays become lists."""
    from cfid.records.parameters import plain

    echo(json.dumps(plain(content), indent=2, allow_nan=False))


def headline(text: str) -> None:
    """Print a line in bold, as the heading of the lines that follow."""
    typer.secho(printable_lines(text), bold=True)


def ask(question: str, *, ring: Callable[[], None] = lambda: None) -> str:
    """Print a question on stderr and return the typed line, or "" where the input ended.

    `ring` calls the operator. Raises OSError where stderr cannot be written, since nobody can have read the question.
    """
    typer.echo(f"{fitted(printable_lines(question), err=True)} ", nl=False, err=True)
    ring()
    line = typed_line()
    if not line.endswith("\n"):
        echo(err=True)  # no line break was typed after the question
    return line


def typed_line() -> str:
    """Return the next line of standard input, and read no byte beyond it, since a script's other answers may follow."""
    if sys.stdin is None:
        return ""
    line = b""
    while not line.endswith(b"\n") and (byte := os.read(sys.stdin.fileno(), 1)):
        line += byte
    return line.decode(errors="replace")


def note(text: str, *, word: str = "note") -> None:
    """Print a note that the operator should know before using the result, or another `word` before it.

    Where stderr cannot be written, as on a full disk, the command continues without the note, since it may be about to
    stop motors.
    """
    try:
        typer.echo(noted(text, word=word), err=True)
    except OSError:
        drop_unwritable()


def noted(text: str, *, word: str = "note") -> str:
    """Return a note as the terminal shows it."""
    line = fitted(f"{word}: {in_options(text)}", indent=_HEAD, err=True)
    return _coloured(line, typer.colors.YELLOW)


def fault(text: str) -> None:
    """Print the error that ends the command."""
    typer.echo(_coloured(fitted(f"cfid: {in_options(text)}", indent=_HEAD, err=True), typer.colors.RED), err=True)


def result(text: str) -> None:
    """Print what a command did, on stderr where stdout cannot be written, as after its terminal was closed."""
    try:
        typer.echo(fitted(printable_lines(text)))
    except OSError:
        drop_unwritable()
        note(text)


def drop_unwritable() -> None:
    """Discard the text of stdout and stderr that cannot be written; Python would try again to write it at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def fitted(text: str, *, indent: int = 0, err: bool = False) -> str:
    """Return a text for stdout or stderr: wrapped and indented for a terminal, unchanged for a file or a pipe.

    Lines that fit, such as those of tables, stay unchanged.
    """
    try:
        columns = os.get_terminal_size((sys.stderr if err else sys.stdout).fileno()).columns
    except (AttributeError, OSError, ValueError):
        return text
    if not columns:
        return text
    wrapper = textwrap.TextWrapper(
        columns, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(line if len(line) <= columns else wrapper.fill(line) for line in text.split("\n"))


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _coloured(text: str, name: str) -> str:
    return text if os.environ.get("NO_COLOR") else typer.style(text, fg=name)
