"""Provide `cfid validate`: compare parameter sets on a flight that none of them was fitted to."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import Figures, Force, FromS, Geometry, Out, PropsOut, ToS
from cfid.console.outcome import Delivery, deliver
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.validation.sets import Measured

ALL = "all"


def validate(
    log: Annotated[str, typer.Argument(metavar="LOG", help="A flight: a log or a run.")],
    *,
    others: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="FILE|NAME|all",
            help="Parameter set to compare: a campaign folder, a parameter file, a published set as `cfid export` "
            "has them, such as thesis, or all of these.",
        ),
    ] = None,
    props_out: PropsOut = False,
    from_s: FromS = None,
    to_s: ToS = None,
    geometry: Geometry = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Compare how well parameter sets predict a flight new to them.

    Example: cfid validate log15.usd --with thesis --with gym-pybullet-drones
    """
    from cfid.console.messages import note
    from cfid.flight.data import read_flight
    from cfid.flight.supply import with_usable_voltage
    from cfid.published import PublishedSet, published_set, published_sets
    from cfid.validation.result import validate as compare
    from cfid.validation.sets import measured_in, published_parameters, sets_of

    workplace = open_workplace(geometry)
    path = find_recording(log, workplace, labelled("flight"))
    flown = with_usable_voltage(read_flight(path, from_s=from_s, to_s=to_s, props_out=props_out))
    in_volts, by_speed = flown.flight.in_volts, flown.flight.speeds is not None
    used = [] if workplace.campaign is None else [measured_in(workplace.campaign)]
    published: dict[str, PublishedSet] = {}
    for word in others or []:
        measured = None if word == ALL else _measured(word)
        if measured is not None:
            used.append(measured)
        else:
            published |= published_sets() if word == ALL else {word: published_set(word)}
    sets, missing = [], []
    for measured in used:
        complete, reasons = sets_of(measured, in_volts=in_volts, by_speed=by_speed)
        sets += complete
        missing += reasons
    left_out: dict[str, list[str]] = {}
    for each in published.values():
        try:
            sets.append(published_parameters(each, in_volts=in_volts, by_speed=by_speed))
        except KeyError as error:
            left_out.setdefault(error.args[0].removeprefix(f"{each.name} "), []).append(each.name)
    for text in (*missing, *(f"left out: {', '.join(names)}: {reason}" for reason, names in left_out.items())):
        note(text)
    result = compare(flown, sets, used=used)
    deliver(result, Delivery(force, figures, out), workplace, keep=False)


def _measured(word: str) -> "Measured | None":
    """Return the values of a campaign's folder or of a kept fit's file; None if the word is not a path."""
    from cfid.records.campaign import open_campaign
    from cfid.validation.sets import measured_file, measured_in

    path = Path(word)
    if path.is_dir():
        return measured_in(open_campaign(path))
    return measured_file(path) if path.is_file() else None
