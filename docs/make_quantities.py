"""Write the tables of docs/reference/parameters.md from the registry: `python docs/make_quantities.py`."""

import re
from collections.abc import Iterator
from pathlib import Path

from cfid.quantities.plausible import judged_unit
from cfid.quantities.registry import QUANTITIES, Quantity, Shape

PAGE = Path(__file__).parent / "reference" / "parameters.md"

KEYS = "| key | unit | what it is | symbol | shape | from |"
RANGES = "| key | what of it | least | largest | why |"


def parameters_page(text: str) -> str:
    """Return the page with both tables written anew from the registry, and the other text unchanged."""
    return _with_table(_with_table(text, KEYS, _keys()), RANGES, _ranges())


def _with_table(text: str, head: str, rows: Iterator[str]) -> str:
    rule = "|---" * (head.count("|") - 1) + "|"
    table = "".join(f"{line}\n" for line in (head, rule, *rows))
    return re.sub(rf"^{re.escape(head)}\n(\|.*\n)*", lambda _: table, text, flags=re.MULTILINE)


def _keys() -> Iterator[str]:
    for one in QUANTITIES:
        cells = (f"`{one.key}`", one.unit, one.title, one.symbol, _shape(one), one.given_by)
        yield f"| {' | '.join(cells)} |"


def _shape(quantity: Quantity) -> str:
    if quantity.shape is Shape.POLYNOMIAL:
        return f"coefficients, {'**lowest**' if quantity.lowest_first else 'highest'} power of {quantity.over} first"
    many = quantity.shape is Shape.LIST and quantity.count
    return f"{quantity.count} numbers" if many else quantity.shape.removeprefix("a ")


def _ranges() -> Iterator[str]:
    for one in QUANTITIES:
        if (found := one.plausible) is not None:
            judged = f"at {found.at:g} {one.over}" if found.at is not None else found.of
            unit = judged_unit(one) if one.unit != "1" else ""
            largest = f"{found.largest:g} {unit}".rstrip()
            yield f"| `{one.key}` | {judged} | {found.least:g} | {largest} | {found.reason} |"


def main() -> None:
    """Write the page."""
    PAGE.write_text(parameters_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
