"""The demo's fits, by the same commands an operator types, and its table of truth against estimate."""

import math
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from cfid.campaign import Campaign
    from cfid.run import Run
    from cfid.sim.demo import DemoTruth

_COVERED = 1.96


def fit_everything(campaign: "Campaign", *, figures: bool) -> None:
    """Fit friction, inertia and test body to the campaign's runs, by the commands that an operator types."""
    from cfid.cli.fit_friction import friction
    from cfid.cli.fit_inertia import inertia
    from cfid.cli.fit_testbody import testbody
    from cfid.run import Run, list_runs

    runs = [run for run in list_runs(campaign.runs_folder) if isinstance(run, Run)]
    for command, chosen in (
        (friction, _names(runs, "drop", None)),
        (inertia, _names(runs, "swing", "crazyflie")),
        (testbody, _names(runs, "swing", "testbody")),
    ):
        typer.secho(f"\n$ cfid fit {command.__name__} {chosen[0]} ... ({len(chosen)} runs)", bold=True)
        command(runs=chosen, campaign=campaign.folder, figures=figures)


def print_comparison(campaign: "Campaign", truth: "DemoTruth") -> None:
    """Print the simulation's truth beside every estimate, and whether it lies in the 95 % interval."""
    from rich.console import Console
    from rich.table import Table

    from cfid.cli.tables import value_and_deviation
    from cfid.parameters import load_sections

    sections = load_sections(campaign.parameters_file)
    found = {name: p for section in sections.values() for name, p in section.parameters.items()}
    table = Table(title="the simulation's truth against the estimates", title_justify="left")
    table.add_column("parameter", overflow="fold")
    for heading in ("truth", "estimate", "std", "in 95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    matrix = found["inertia.matrix_kg_m2"]
    rows = [
        (f"inertia {a}{b}", truth.inertia_kg_m2[i][j], matrix.value[i][j], matrix.std[i][j])
        for i, a in enumerate("xyz")
        for j, b in enumerate("xyz")
        if i <= j
    ]
    for key, value in (
        ("friction.coulomb_nm", truth.coulomb_nm),
        ("friction.viscous_nms_per_rad", truth.viscous_nms_per_rad),
        ("friction.setup_inertia_kg_m2", truth.setup_inertia_kg_m2),
        *((f"testbody.measured_kg_m2.{axis}", inertia) for axis, inertia in truth.testbody_kg_m2.items()),
    ):
        rows.append((key, value, found[key].value, found[key].std))
    for name, true, value, std in rows:
        inside = std is not None and math.isclose(true, value, rel_tol=0, abs_tol=_COVERED * std)
        table.add_row(name, f"{true:.5g}", *value_and_deviation(value, std), "yes" if inside else "no")
    Console().print(table)
    typer.echo("one in twenty lies outside its 95 % interval by chance.")
    typer.echo(f"the campaign is {campaign.folder}: look at its rig.toml, runs and parameters.toml.")


def _names(runs: "list[Run]", kind: str, body: str | None) -> list[str]:
    return [run.folder.name for run in runs if run.header.kind == kind and run.header.label.body == body]
