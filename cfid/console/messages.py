"""Print notes and errors to stderr, in colour unless NO_COLOR is set."""

import contextlib
import os
import sys

import typer


def note(text: str) -> None:
    """Print a note that the operator should know before using the result."""
    typer.echo(noted(text), err=True)


def noted(text: str) -> str:
    """Return a note as the terminal shows it."""
    return typer.style(f"note: {text}", fg=_colour(typer.colors.YELLOW))


def fault(text: str) -> None:
    """Print the error that ends the command."""
    typer.secho(f"cfid: {text}", err=True, fg=_colour(typer.colors.RED))


def result(text: str) -> None:
    """Print what a command did; where stdout takes nothing, as a terminal that was closed, print it on stderr."""
    try:
        typer.echo(text)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the rest of the text fails once more
        with contextlib.suppress(OSError):
            note(text)


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _colour(name: str) -> str | None:
    return None if os.environ.get("NO_COLOR") else name
