"""`cfid rig check` and `cfid rig sim`: check the devices, or simulate them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.messages import echo, fitted, in_options, note, print_json
from cfid.console.options import positive
from cfid.console.program import program
from cfid.console.recording import rig_of
from cfid.console.signals import judged, look
from cfid.errors import DeviceError
from cfid.rig.check import DeviceAnswer, check_encoder, check_lines, check_loadcell, check_vehicle
from cfid.rig.encoder import ready_encoder
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.ready_vehicle import connect_vehicle

if TYPE_CHECKING:
    from cfid.console.recording import Rig
    from cfid.console.signals import Answers
    from cfid.rig.instrument import Instrument
    from cfid.rig.loop import Ending, Loop

_ANSWERS_AT = 35  # the column in which answers of `cfid rig check` begin


def check(
    *,
    signals: Annotated[
        bool,
        typer.Option("--signals", help="Judge signals, too, with motors off: rate, losses, noise, drift, battery."),
    ] = False,
    for_s: Annotated[float, typer.Option("--for", metavar="S", help="Seconds of signals to judge.")] = 10.0,
) -> None:
    """Identify every device, and report faults and remedies.

    A load cell's box streams to only one client: the check takes over the stream for a moment, unless a `cfid log`
    holds it. With `--signals`, each device that answers is then sampled at rest, with the settings of rig.toml, and
    judged by its limits.

    Example: cfid rig check --signals
    """
    rig = rig_of(or_real=True)
    devices, stated, hardware = rig.devices, rig.campaign.rig, rig.hardware
    if remedy := stated.unknown():
        note(f"rig.toml: {remedy}")
    hand_held = {"tachometer": devices.tachometer, "scales": devices.scales}
    findings: dict[str, Sequence[DeviceAnswer]] = {}
    if stated.campaign.kind != "owner":
        counts_per_turn = stated.encoder.counts_per_turn
        findings["encoder"] = check_encoder(devices.encoder, hardware, counts_per_turn=counts_per_turn)
        findings["loadcell"] = check_loadcell(devices.loadcell, hardware)
    findings |= {name: check_lines(name, sender, hardware) for name, sender in hand_held.items() if sender is not None}
    findings["crazyflie"] = check_vehicle(devices.crazyflie, stated.vehicle.platform, hardware)
    if signals:
        for name, answers in _judged_signals(rig, findings, for_s=positive(for_s, "--for")).items():
            findings[name] = [*findings[name], *answers]
    report_answers("rig check", findings, simulated=rig.simulated)


def _judged_signals(rig: "Rig", identified: "Mapping[str, Sequence[DeviceAnswer]]", *, for_s: float) -> "Answers":
    """Sample the devices that answered, and judge their signals; a device that fails has a fault in its place."""
    devices, stated, hardware = rig.devices, rig.campaign.rig, rig.hardware
    counts_per_turn = stated.encoder.counts_per_turn
    ready: dict[str, Callable[[ExitStack], Instrument]] = {
        "encoder": lambda held: ready_encoder(
            devices.encoder, hardware, held, counts_per_turn=counts_per_turn, say=note
        ),
        "loadcell": lambda held: ready_loadcell(devices.loadcell, hardware, held, say=note, patient=False),
        "crazyflie": lambda held: connect_vehicle(devices.crazyflie, hardware, held).usual_log(),
    }
    answers: dict[str, list[DeviceAnswer]] = {}
    for name, instrument_of in ready.items():
        if any(answer.state == "fault" for answer in identified.get(name, ())) or len(identified.get(name, ())) < 2:
            continue  # it does not answer, or another program holds it
        try:
            with ExitStack() as held:
                instrument = instrument_of(held)
                sampled = look([instrument], hardware, for_s=for_s)
                supply = devices.crazyflie.supply
                answers |= judged({name: instrument.record}, sampled, stated.check, supply=supply)
        except DeviceError as error:
            answers[name] = [DeviceAnswer("signals", "fault", str(error))]
    return answers


def report_answers(command: str, answers: "Mapping[str, Sequence[DeviceAnswer]]", *, simulated: bool) -> None:
    """Print the answers of the devices. Raises DeviceError, which names the devices with a fault."""
    if program().json:
        content = {name: [answer._asdict() for answer in device_answers] for name, device_answers in answers.items()}
        print_json({"command": command, "simulated": simulated, "devices": content})
    else:
        for name, answer in ((name, answer) for name, device_answers in answers.items() for answer in device_answers):
            limit = f" (limit {answer.limit})" if answer.limit else ""
            line = f"{name:9} {answer.asked:15} {answer.state:8} {in_options(answer.answer)}{limit}"
            echo(fitted(line, indent=_ANSWERS_AT))
            if answer.advice:
                echo(fitted(f"{'':{_ANSWERS_AT}}-> {answer.advice}", indent=_ANSWERS_AT + 3))
    faulty = [
        name for name, device_answers in answers.items() if any(answer.state == "fault" for answer in device_answers)
    ]
    if faulty:
        raise DeviceError(f"not ready: {', '.join(faulty)}.")


def sim(
    *,
    for_s: Annotated[
        float | None, typer.Option("--for", metavar="S", help="Seconds to serve; default: until Ctrl-C.")
    ] = None,
    truth: Annotated[Path | None, typer.Option(help="TOML file with the true parameters.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rig's parameters and noise.")] = 1,
    axis: Annotated[str | None, typer.Option(metavar="MOUNT", help="Mount on which the vehicle swings.")] = None,
    weight: Annotated[
        float | None, typer.Option(metavar="GRAMS", help="Drop this weight instead of swinging the vehicle.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DEVICE.FAULT=VALUE", help="Fault to simulate, such as loadcell.drop_every=100; can be repeated."
        ),
    ] = None,
) -> None:
    """Serve a simulated encoder, load cell and Crazyflie on real interfaces; cfid's commands use them while this runs.

    The vehicle is a Crazyflie 2.x, or a 2.1 Brushless where rig.toml or the truth file states it.

    Example: cfid rig sim --axis x
    """
    from cfid.console.campaign import here
    from cfid.rig.loop import run_until_done
    from cfid.rig.sim_file import published
    from cfid.sim.devices import SimulatedRig
    from cfid.sim.faults import parse_faults
    from cfid.sim.service import ServedRig, devices_at
    from cfid.sim.truth import load_truth, usual_truth

    if for_s is not None:
        positive(for_s, "--for")
    campaign = here()
    is_brushless = campaign.rig.vehicle.platform == "cf21bl"

    async def main(loop: "Loop", ending: "Ending") -> None:
        with TemporaryDirectory(prefix="cfid-sim-") as folder:
            encoder_faults, loadcell_faults, crazyflie_faults = parse_faults(fault or ())
            rig = SimulatedRig(
                campaign.rig,
                seconds=loop.seconds,
                seed=seed,
                truth=load_truth(truth) if truth else usual_truth("cf21bl" if is_brushless else "cf2"),
                encoder_faults=encoder_faults,
                loadcell_faults=loadcell_faults,
                crazyflie_faults=crazyflie_faults,
                axis=axis,
                weight_g=weight,
            )
            served = ServedRig(rig, reactor=loop, folder=Path(folder))
            devices = devices_at(served.open(), campaign.rig.devices, supply=rig.on_supply)
            try:
                with published(campaign.folder, devices, seed=seed) as path:
                    echo(f"{path}: cfid's commands use the simulated rig until this ends (Ctrl-C).", err=True)
                    await ending.within(for_s)
            finally:
                await served.close()

    run_until_done(main)
