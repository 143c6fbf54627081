"""`cfid tf verify`: an identified transfer function against sine runs that it was not made from (figure 3.16)."""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.lists import comma_list
from cfid.console.options import Delivery, LoadCellOptions, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.transfer.options import FunctionOptions, SineInputs

if TYPE_CHECKING:
    from cfid.transfer.verification_result import Function

_EXAMPLE = "1,-0.97"


@flat
def verify(
    *,
    runs: Annotated[
        list[str] | None, typer.Argument(metavar="RUN ...", help="Runs that were left out of the fit.")
    ] = None,
    inputs: SineInputs,
    function: FunctionOptions,
    settle_s: Annotated[float, typer.Option(min=0, help="Of each run's beginning left out.")] = 1.0,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Simulate the campaign's transfer function, or one by its numbers, against runs it was not identified from.

    Example: [bold]cfid tf verify 2026-11-21_083012_sine_l12[/bold]
    """
    from cfid import transfer
    from cfid.errors import ConfigError

    workplace = open_workplace(rig)
    known = _function(function, workplace)
    if not runs and inputs.index is None:
        raise ConfigError("nothing to verify with: give a RUN that was left out of the fit, or --index FILE.")
    sines = inputs.read(runs, scale.reading(reading), workplace)
    result = transfer.verify(sines, known, sign=inputs.sign, settle_s=settle_s)
    deliver(replace(result, folder=workplace.figures_beside(sines.paths)), delivery, workplace.campaign)


def _function(options: FunctionOptions, workplace: Workplace) -> "Function":
    """Return the function of the options, else that of the campaign. Raises ConfigError for half of either."""
    from cfid.errors import ConfigError
    from cfid.transfer.verification_result import Function

    if options.numerator is None and options.denominator is None:
        return _of_campaign(options, workplace)
    if options.numerator is None or options.denominator is None:
        raise ConfigError("--numerator and --denominator belong together: give both, or none for the campaign's.")
    return Function.of_coefficients(
        comma_list(options.numerator, "--numerator", float, example=_EXAMPLE),
        comma_list(options.denominator, "--denominator", float, example=_EXAMPLE),
        delay_s=options.delay_s or 0.0,
    )


def _of_campaign(options: FunctionOptions, workplace: Workplace) -> "Function":
    from cfid.errors import ConfigError, DataError
    from cfid.records.parameters import load_sections
    from cfid.transfer.verification_result import Function

    if workplace.campaign is None:
        raise ConfigError("no campaign here that has a transfer function: give --numerator, --denominator, --delay-s.")
    path = workplace.campaign.parameters_file
    section = load_sections(path).get("tf")
    if section is None:
        raise ConfigError(f"{path}: has no transfer function yet: run `cfid tf identify`, or give --numerator ...")
    try:
        return Function.of_quantities(section.parameters, section.sources, delay_s=options.delay_s)
    except DataError as error:
        raise DataError(f"{path}: section tf: {error}") from None
