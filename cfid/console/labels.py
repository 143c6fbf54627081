"""The label that the operator gives a run: mount, weight, body and note, as options of a command."""

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.console.lists import comma_list, measured
from cfid.errors import ConfigError
from cfid.records.lab_book import check
from cfid.records.run import Label

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign


def _checked(note: str | None) -> str | None:
    """Return the note, checked for a run that will be recorded. Raises ConfigError as `cfid runs note` does."""
    check(note or "")
    return note


Note = Annotated[
    str | None,
    typer.Option(metavar="TEXT", help="Note to keep; key=value is a lab book entry.", callback=_checked),
]


Axis = Annotated[str | None, typer.Option(metavar="MOUNT", help="Mount of a swing, as named in rig.toml.")]
Weight = Annotated[
    str | None,
    typer.Option(metavar="GRAMS[:STD]", help="Mass of the dropped or hanging weight."),
]
Body = Annotated[
    Literal["crazyflie", "testbody", "fixture"] | None,
    typer.Option(metavar="BODY", help="crazyflie (default with --axis), testbody or fixture."),
]
Pull = Annotated[
    Literal["x", "-x", "y", "-y", "z", "-z"] | None,
    typer.Option(help="Load cell's axis along which gravity points."),
]
AtMm = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z[:STD]",
        help="Position of the weight, from the load cell's origin.",
    ),
]


def kind_of_angles(axis: str | None, weight: str | None) -> str:
    """Return the kind of a run that records the encoder with this label."""
    return "swing" if axis else "drop" if weight else "encoder"


def label_of(
    axis: str | None, weight: str | None, body: str | None, note: str | None, campaign: "Campaign | None"
) -> Label:
    """Return a run's label, checked against rig.toml, so that a misspelt mount is found before the recording starts.

    Without a campaign, no mount is known that it could be checked against.

    Raises ConfigError.
    """
    body = body or ("crazyflie" if axis else None)
    if axis and weight:
        raise ConfigError("--axis is for a swing and --weight for a dropping weight: give one of them.")
    mass = measured(weight, "--weight")
    rig = None if campaign is None else campaign.rig
    mounts, table = {} if rig is None else rig.mounts, "mounts"
    if rig is not None and body == "testbody" and rig.testbody is not None:
        mounts, table = rig.testbody.mounts, "testbody.mounts"
    if axis and rig is not None and body != "fixture" and axis not in mounts:
        remedy = rig.unknown(f"{table}.{axis}") or f"it has {', '.join(mounts) or 'none'}."
        raise ConfigError(f"--axis {axis}: rig.toml has no such mount of the {body}; {remedy}")
    return Label(axis=axis, weight_g=mass.value, weight_std_g=mass.std, body=body, note=note)


def with_load(label: Label, pull: str | None, at_mm: str | None) -> Label:
    """Return the label with a known load on the load cell, for `cfid fit loadcell`.

    Raises ConfigError for a place or a weight that lacks a required option.
    """
    if pull is None and (at_mm or label.weight_g):
        raise ConfigError("a weight needs --pull: the axis of the load cell along which gravity points.")
    if at_mm and not label.weight_g:
        raise ConfigError("--at-mm: is where a weight hangs: give --weight too.")
    if at_mm is None:
        return label.model_copy(update={"pull": pull})
    words, colon, spread = at_mm.partition(":")
    place = comma_list(words, "--at-mm", float, example="46,0,0")
    std = comma_list(spread, "--at-mm", float, least=0, example="46,0,0:0.2") if colon else ()
    if len(place) != 3 or len(std) > 1:
        raise ConfigError(
            f"--at-mm {at_mm}: should be three numbers, as in 46,0,0, or with their standard uncertainty, as "
            "in 46,0,0:0.2."
        )
    return label.model_copy(update={"pull": pull, "at_mm": place, "at_std_mm": next(iter(std), None)})
