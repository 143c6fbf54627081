"""`cfid tf identify`: sine runs to the transfer function of motor and rotor."""

from dataclasses import replace
from typing import Annotated, Literal

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.options import Delivery, LoadCellOptions, Method, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.transfer.options import FitOptions, SineInputs, ThesisOptions

Words = Annotated[
    list[str] | None, typer.Argument(metavar="RUN ...", help="Runs of cfid log sine; default: all complete ones.")
]
Compare = Annotated[Literal["eq3.15", "eq3.16"] | None, typer.Option(help="A result of the thesis to compare with.")]


@flat
def identify(
    *,
    runs: Words = None,
    inputs: SineInputs,
    fit: FitOptions,
    thesis: ThesisOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    compare: Compare = None,
    method: Method = "default",
) -> None:
    """Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).

    H(z) is given in z^-1 with the denominator's leading 1. The delay counts from the stamps of the reports.

    Example: [bold]cfid tf identify 2026-11-21_083012_sine_l1 2026-11-21_083030_sine_l2 ...[/bold]
    """
    from cfid import transfer

    workplace = open_workplace(rig)
    sines = inputs.read(runs, scale.reading(reading), workplace)
    result = transfer.fit(
        sines,
        sign=inputs.sign,
        shape=fit.shape,
        form=fit.form,
        settle_s=fit.settle_s,
        cutoff_hz=fit.cutoff_hz,
        settings=thesis.settings,
        thrust_poly=_thrust_poly(workplace),
        compare=compare,
        method=method,
    )
    deliver(replace(result, folder=workplace.figures_beside(sines.paths)), delivery, workplace.campaign)


def _thrust_poly(workplace: Workplace) -> list[float] | None:
    """Return the campaign's thrust over command, if it has found one."""
    from cfid.records.parameters import load_sections

    if workplace.campaign is None:
        return None
    section = load_sections(workplace.campaign.parameters_file).get("thrust")
    poly = None if section is None else section.parameters.get("motor.thrust_poly")
    return None if poly is None else list(poly.value)
