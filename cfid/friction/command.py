"""`cfid fit friction`: Coulomb and viscous friction of the axis, from dropped weights."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace, read_recording, split_label
from cfid.console.lists import measured
from cfid.console.options import Figures, Force, FromS, Geometry, GravityMps2, Method, Out, ToS
from cfid.console.outcome import Delivery, deliver
from cfid.console.selection import chosen
from cfid.records.choose import labelled
from cfid.units import MM

if TYPE_CHECKING:
    from cfid.findings import Finding
    from cfid.recordings.angle import AngleRecord


def friction(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="GRAMS[:STD]=FILE|RUN ...",
            help="Dropped weights; a run states its own in its label; default: the campaign's complete drops.",
        ),
    ] = None,
    *,
    from_s: FromS = None,
    to_s: ToS = None,
    geometry: Geometry = None,
    radius_mm: Annotated[
        str | None,
        typer.Option(
            metavar="MM[:STD]",
            help="Radius to the middle of the line: that of the axis plus half the line's thickness.",
        ),
    ] = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit the friction of the swing's axis to weights dropped on a line wound around it.

    cfid finds the window of steady speed in each run; --from and --to set one window for all runs given.

    Example: cfid fit friction 20=drop_20g.csv 30=drop_30g.csv 40=drop_40g.csv --radius-mm 2
    """
    from cfid.friction import result

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(geometry, gravity=gravity)
    words = chosen(runs, workplace.campaign, suits=labelled("drop"), wanted="dropped weights")
    radius = measured(radius_mm, "--radius-mm")
    records, left_out = _read_weights(words, workplace)
    found = result.fit(
        records,
        rig=None if workplace.borrowed else workplace.rig,
        radius_m=None if radius.value is None else MM * radius.value,
        radius_std_m=None if radius.std is None else MM * radius.std,
        gravity_mps2=gravity.value,
        gravity_std_mps2=gravity.std,
        from_s=from_s,
        to_s=to_s,
        method=method,
    )
    found = replace(found, findings=(*left_out, *found.findings))
    deliver(found, Delivery(force, figures, out), workplace)


def _read_weights(words: Sequence[str], workplace: Workplace) -> "tuple[list[AngleRecord], list[Finding]]":
    """Read GRAMS=FILE, or a RUN whose label has its weight; return warnings on files and runs that cannot be read.

    Raises ConfigError for an invalid weight, DataError for a file that does not exist, and where none can be read.
    """
    from cfid.errors import DataError
    from cfid.findings import warning
    from cfid.recordings import angle

    found, left_out = [], []
    first: DataError | None = None
    for word in words:
        label, rest = split_label(word, workplace)
        weight = _weight(label) if label else {}
        path = find_recording(rest, workplace, labelled("drop"))
        try:
            record = angle.angle_record(read_recording(str(path), workplace))
        except DataError as error:  # one recording does not condemn the others
            if not path.exists():
                raise
            first = first or error
            left_out.append(warning("friction-drop-left-out", f"{error} It is left out."))
        else:
            found.append(angle.labelled(record, **weight))
    if first is not None and not found:
        raise first
    return found, left_out


def _weight(text: str) -> dict[str, float | None]:
    """Return the parts of a label that GRAMS[:STD] states."""
    from cfid.errors import ConfigError

    try:
        weight = measured(text, "GRAMS=")
    except ConfigError:
        raise ConfigError(f"'{text}' is no weight in grams: write GRAMS=FILE, or GRAMS:STD=FILE.") from None
    return {"weight_g": weight.value} | ({} if weight.std is None else {"weight_std_g": weight.std})
