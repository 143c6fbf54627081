"""Write docs/reference/commands.md from the program's own help: `python docs/make_commands.py`."""

import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from cfid.cli.main import app
from cfid.cli.table import COMMANDS

PAGE = Path(__file__).parent / "reference" / "commands.md"

HEAD = """# Commands

`python docs/make_commands.py` writes this page from `--help`, and a test compares the two.
Each command has `--help` (or `-h`), which is left out below. With `cfid --install-completion` the shell
completes commands and options.

Square brackets in the usage mark what may be left out. [Exit codes](exit-codes.md) are the same everywhere.
"""


def commands_page() -> str:
    """Return the page: every command with its usage, help and options."""
    return HEAD + "".join(_sections(get_command(app), "cfid", None))


def _sections(command: Any, name: str, parent: Any) -> Iterator[str]:
    context = command.context_class(command, info_name=name.rpartition(" ")[2], parent=parent)
    yield _section(command, name, context)
    for word in getattr(command, "commands", ()):
        _, below, _ = command.resolve_command(context, [word])  # the imported command, not its entry in a list
        yield from _sections(below, f"{name} {word}", context)
        for own in _below_a_command(below, f"{name} {word}"):
            _, group, _ = command.resolve_command(context, [word, own])
            inner = group.context_class(group, info_name=word, parent=context)
            yield from _sections(group.resolve_command(inner, [own])[1], f"{name} {word} {own}", inner)


def _below_a_command(command: Any, name: str) -> list[str]:
    """Return the commands below a command that is no group, such as `fleet fit`; it takes all other words itself."""
    if hasattr(command, "commands"):
        return []
    paths = [path.rpartition(" ") for path in COMMANDS]
    return [own for above, _, own in paths if above == name.removeprefix("cfid ")]


def _section(command: Any, name: str, context: Any) -> str:
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    parts = [f"\n## {name}\n", f"    {usage}\n", _prose(command.help or "")]
    rows = [record for each in command.params if (record := _row(each, context))]
    if rows:
        parts.append("| option | meaning |\n|---|---|\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def _row(parameter: Any, context: Any) -> str | None:
    record = parameter.get_help_record(context)
    if record is None or parameter.name == "help":
        return None
    words, said = (" ".join(text.split()) for text in record)
    return f"| {_code(words)} | {_plain(said)} |"


def _code(words: str) -> str:
    """Return words as code; a plain bar would end the cell of a table, so words with bars become an HTML tag."""
    return f"<code>{html.escape(words).replace('|', '&#124;')}</code>" if "|" in words else f"`{words}`"


def _prose(text: str) -> str:
    paragraphs = [" ".join(each.split()) for each in text.split("\n\n")]
    return "\n\n".join(_plain(each) for each in paragraphs) + "\n"


def _plain(text: str) -> str:
    """Return help as Markdown: text that is bold on the terminal becomes code, and other text cannot form a tag."""
    bold = re.sub(r"\[bold\](.*?)\[/bold\]", r"`\1`", text).replace(r"\[", "[")
    pieces = bold.split("`")  # every second piece was in backticks
    return "`".join(piece if number % 2 else _escaped(piece) for number, piece in enumerate(pieces))


def _escaped(text: str) -> str:
    return re.sub(r"([<>*_\[\]|])", r"\\\1", text)


def main() -> None:
    """Write the page."""
    PAGE.write_text(commands_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
