"""What the program says itself, as Markdown: `python docs/make_reference.py commands` (or keys, ranges, findings,
imperfections).

The site is built with these texts in it (docs/site/pages_beside.py), so none of them is kept twice.
"""

import ast
import html
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from cfid.cli.main import app
from cfid.findings import CODES, SEVERITIES
from cfid.quantities.plausible import judged_unit
from cfid.quantities.registry import QUANTITIES, Quantity, Shape
from cfid.sim.truth import IMPERFECTIONS

PACKAGE = Path(__file__).parents[1] / "cfid"


def commands() -> str:
    """Return the page of commands: each with its usage, help and options."""
    return "# Commands\n\nEach command has `--help`, which prints the same.\n" + "".join(
        _sections(get_command(app), "cfid", None)
    )


def _sections(command: Any, name: str, parent: Any) -> Iterator[str]:
    context = command.context_class(command, info_name=name.rpartition(" ")[2], parent=parent)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    rows = [record for parameter in command.params if (record := parameter.get_help_record(context))]
    options = _table(("option", "meaning"), ((_code(words), _plain(text)) for words, text in rows))
    prose = "\n\n".join(_plain(paragraph) for paragraph in (command.help or "").split("\n\n"))
    yield f"\n## {name}\n\n    {usage}\n\n{prose}\n\n{options}"
    for word in getattr(command, "commands", ()):
        yield from _sections(command.resolve_command(context, [word])[1], f"{name} {word}", context)


def _code(words: str) -> str:
    """Return words as code; a plain bar would end the cell of a table."""
    return f"<code>{html.escape(' '.join(words.split())).replace('|', '&#124;')}</code>"


def _plain(text: str) -> str:
    """Return help as Markdown: text that is bold on the terminal becomes code, and other text cannot form a tag."""
    marked = re.sub(r"\[bold\](.*?)\[/bold\]", r"`\1`", " ".join(text.split())).replace(r"\[", "[")
    pieces = marked.split("`")  # every second piece was in backticks
    return "`".join(piece if n % 2 else re.sub(r"([<>*_\[\]|])", r"\\\1", piece) for n, piece in enumerate(pieces))


def keys() -> str:
    """Return the table of all quantities."""
    head = ("key", "unit", "what it is", "symbol", "shape", "from")
    rows = ((f"`{q.key}`", q.unit, q.title, q.symbol, _shape(q), q.given_by) for q in QUANTITIES)
    return _table(head, rows)


def _shape(quantity: Quantity) -> str:
    if quantity.shape is Shape.POLYNOMIAL:
        return f"coefficients, {'**lowest**' if quantity.lowest_first else 'highest'} power of {quantity.over} first"
    many = quantity.shape is Shape.LIST and quantity.count
    return f"{quantity.count} numbers" if many else quantity.shape.removeprefix("a ")


def ranges() -> str:
    """Return the table of plausible ranges."""
    return _table(("key", "what of it", "least", "largest", "why"), _ranges())


def _ranges() -> Iterator[tuple[str, ...]]:
    for quantity in QUANTITIES:
        if (plausible := quantity.plausible) is not None:
            judged = f"at {plausible.at:g} {quantity.over}" if plausible.at is not None else plausible.of
            unit = judged_unit(quantity) if quantity.unit != "1" else ""
            least, largest = f"{plausible.least:g}", f"{plausible.largest:g} {unit}".rstrip()
            yield f"`{quantity.key}`", judged, least, largest, plausible.reason


def findings() -> str:
    """Return the table of all findings: code, severities and sentence, with `...` for its numbers."""
    severities: dict[str, set[str]] = defaultdict(set)
    sentences = {code: re.sub(r"{[^}]*}", "...", sentence) for code, (_, sentence) in CODES.items()}
    for code, (severity, _) in CODES.items():
        severities[code].add(severity)
    for path in sorted(PACKAGE.rglob("*.py")):
        for code, severity, sentence in findings_in(path.read_text(encoding="utf-8")):
            severities[code].add(severity)
            sentences[code] = sentences.get(code) or sentence
    rows = ((f"`{code}`", ", ".join(sorted(severities[code])), _plain(sentences[code])) for code in sorted(severities))
    return _table(("code", "severity", "sentence"), rows)


def findings_in(source: str) -> Iterator[tuple[str, str, str]]:
    """Yield code, severity and sentence of each finding that a module makes; the code is written out in the call."""
    if "cfid.findings" not in source:
        return
    nodes = list(ast.walk(ast.parse(source)))
    imports = (node for node in nodes if isinstance(node, ast.ImportFrom) and node.module == "cfid.findings")
    names = {alias.asname or alias.name: alias.name for node in imports for alias in node.names}
    for node in nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and names.get(node.func.id) in SEVERITIES:
            code, *rest = node.args
            if not isinstance(code, ast.Constant):
                raise ValueError(f"line {node.lineno}: the code of a finding is not written out")
            yield str(code.value), names[node.func.id], _sentence(_assigned(rest[0], nodes)) if rest else ""


def _assigned(node: ast.expr, nodes: Iterable[ast.AST]) -> ast.expr:
    """Return an expression, or of a name what was last assigned to it above."""
    if not isinstance(node, ast.Name):
        return node
    above = [
        assign.value
        for assign in nodes
        if isinstance(assign, ast.Assign | ast.AugAssign | ast.NamedExpr) and assign.lineno < node.lineno
        for target in (assign.targets if isinstance(assign, ast.Assign) else [assign.target])
        if isinstance(target, ast.Name) and target.id == node.id
    ]
    return max(above, key=lambda value: value.lineno, default=node)


def _sentence(node: ast.expr) -> str:
    """Return the text of a string or an f-string, with `...` for each value."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_sentence(part) for part in node.values)
    if isinstance(node, ast.BinOp):
        return _sentence(node.left) + _sentence(node.right)
    return "..."


def imperfections() -> str:
    """Return the table of the simulated rig's imperfections."""
    head = ("key", "what it is", "distribution", "size", "unit")
    return _table(head, ((f"`{i.key}`", i.text, i.distribution, f"{i.size:g}", i.unit) for i in IMPERFECTIONS))


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * (lines[0].count(" | ") + 1) + "|", *lines[1:]]) + "\n" if lines[1:] else ""


TEXTS = {
    "commands": commands, "keys": keys, "ranges": ranges, "findings": findings, "imperfections": imperfections,
}  # fmt: skip

if __name__ == "__main__":
    print(TEXTS[sys.argv[1]]())
