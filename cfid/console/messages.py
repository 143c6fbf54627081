"""What is said to a person beside the result: on stderr, and in colour unless NO_COLOR is set."""

import os

import typer


def note(text: str) -> None:
    """Say what the operator should know before using the result."""
    typer.echo(noted(text), err=True)


def noted(text: str) -> str:
    """Return a note as it looks on a terminal."""
    return typer.style(f"note: {text}", fg=_colour(typer.colors.YELLOW))


def fault(text: str) -> None:
    """Say why the command ends here."""
    typer.secho(f"cfid: {text}", err=True, fg=_colour(typer.colors.RED))


def _colour(name: str) -> str | None:
    return None if os.environ.get("NO_COLOR") else name
