"""Record sines, each as a run of its own, in the order of a sweep, and judge each as soon as it is recorded."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from cfid.console.live import LiveLine
from cfid.console.messages import note as speech
from cfid.console.recording import Rig, attempt, effort_of
from cfid.console.run_summary import Judge, judged, summary
from cfid.console.signals import NOT_READ, quick
from cfid.console.vehicle import LOG_MS, confirm, reach, refuse
from cfid.errors import CfidError, FitError
from cfid.estimate.battery_endurance import Held
from cfid.recordings.wrench import LOADCELL
from cfid.records.campaign import Campaign
from cfid.records.rig_file import LoadCellBox, LoadCellLines
from cfid.records.run import Label, Run
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.run import Plan
from cfid.rig.sine import Crossings
from cfid.transfer.alignment import align
from cfid.transfer.data import read_sines
from cfid.transfer.plan import CUTOFF_HZ, PLANNED, Sine
from cfid.units import FULL_COMMAND, MOTORS
from cfid.wire.app import MIDDLE, SineRequest

_FELT = 5.0  # standard uncertainties of an amplitude that the load cell measures


def record_sines(
    sines: Sequence[Sine],
    rig: Rig,
    *,
    planned: Sequence[int],
    before_s: float,
    each_s: float,
    uri: str | None,
    preflight: bool,
    rate_hz: int | None,
    note: str | None,
    judge: Judge,
    show: Callable[[Sine, Run], None],
) -> tuple[list[dict[str, Any]], CfidError | None]:
    """Play sines of one amplitude in turn; return a summary of each run, and the error that ended them.

    `planned` are the l of the whole series; if there are several, each run states them. `show` gets each run at its
    end. Raises ConfigError or DeviceError before the first motor turns.
    """
    campaign = rig.campaign
    cell = rig.devices.loadcell.sampled_at(rate_hz)
    live, runs = LiveLine(), []
    failure: CfidError | None = None
    with ExitStack() as held:
        crazyflie = reach(uri, rig, held)
        crazyflie.crossings()  # refuses a vehicle without sines before the operator has to do anything
        amplitude = int(sines[0].amplitude)
        least, largest = max(MIDDLE - amplitude, 1), min(MIDDLE + amplitude, FULL_COMMAND)
        turning = [(motor,) if motor else MOTORS for motor in dict.fromkeys(sine.motor for sine in sines)]
        for motors in turning:  # while one turns, the others stand still or idle
            crazyflie.limits.check_turning(motors, least, largest)
        effort = effort_of(len(sines) * each_s, campaign.runs_folder, rate_hz=cell.rate_hz + 1000 / LOG_MS)
        refuse(crazyflie, sorted({*chain(*turning)}), (least, largest))
        held_in_all = [held for sine in sines for held in sine.held(each_s)]
        effort += _quick(cell, rig, lambda: crazyflie.usual_log(LOG_MS), held_in_all) if preflight else NOT_READ
        confirm(crazyflie, sorted({*chain(*turning)}), (least, largest), effort=effort, ring=live.ring)
        for count, sine in enumerate(sines):
            name = f"{sine.hz:g} Hz ({count + 1} of {len(sines)})"
            live.task(f"{name}: pause")

            def tell(text: str, name: str = name) -> None:
                live.task(f"{name}: {text}")

            plan = plan_sine(sine, campaign, before_s=before_s, note=note, simulated=rig.simulated, tell=tell)
            requested = {**plan.requested, **({PLANNED: list(planned)} if len(planned) > 1 else {})}
            # Including the runs after this one.
            plan = replace(plan, requested=requested, lasts_s=(len(sines) - count) * each_s)
            parts = [crazyflie.crossings(), *crazyflie.watch(LOG_MS)]
            run, failure = _play(plan, parts, cell, live, hardware=rig.hardware)
            if run is not None:
                run = judged(run, judge)
                runs.append(summary("log sine", run, failure))
                show(sine, run)
            if failure is not None or run is None or run.header.state != "complete":
                break
    return runs, failure


def _quick(cell: LoadCellBox | LoadCellLines, rig: Rig, log: Callable[[], Instrument], plan: Sequence[Held]) -> str:
    with ExitStack() as stream:
        loadcell = ready_loadcell(cell, rig.hardware, stream, say=speech, patient=False)
        supply = rig.devices.crazyflie.supply
        return quick(lambda: [loadcell, log()], plan, rig.hardware, rig.campaign.rig.check, supply=supply)


def _play(
    plan: Plan,
    vehicle: Sequence[Instrument],
    cell: LoadCellBox | LoadCellLines,
    live: LiveLine,
    *,
    hardware: Hardware,
) -> tuple[Run | None, CfidError | None]:
    reports, *others = vehicle
    with ExitStack() as stream:
        try:
            loadcell = ready_loadcell(cell, hardware, stream, say=live.say, patient=False)
        except CfidError as error:
            return None, error
        return attempt(plan, [reports, loadcell, *others], hardware, live)


def plan_sine(
    sine: Sine,
    campaign: Campaign,
    *,
    before_s: float,
    note: str | None,
    simulated: bool,
    tell: Callable[[str], None],
) -> Plan:
    """Return the plan of a run that records `before_s` seconds with the motors off, then plays the sine."""
    return Plan(
        runs_folder=campaign.runs_folder,
        kind=f"sine_l{sine.periods}",
        label=Label(note=note),
        procedure=lambda there, hardware: play_sine(
            sine.request(), there["crossings"], before_s=before_s, hardware=hardware, tell=tell
        ),
        tare_s=before_s,
        facts=campaign.rig.facts.of("loadcell"),
        requested=sine.to_run(),
        simulated=simulated,
    )


async def play_sine(
    request: SineRequest, crossings: Crossings, *, before_s: float, hardware: Hardware, tell: Callable[[str], None]
) -> None:
    """Pause, for the load cell's bias, then play one sine to its end (section 3.4.2)."""
    await hardware.sleep(before_s)
    tell("playing")
    await crossings.play(request)


def verdict(run: Run) -> str:
    """State how clearly the load cell measures a sine. Raises DataError or FitError if not, or for missing reports."""
    axes, motor = run.header.devices[LOADCELL].columns, run.header.requested.get("motor")
    mount = run.header.rig.loadcell
    on_arm = motor and {"Tx", "Ty"} <= set(axes) and None not in (mount.arm_mm, mount.yaw_deg)  # all motors: no torque
    sines = read_sines([run], channel="arm" if on_arm else "Fz")
    (played,) = align(sines.runs).runs
    if not played.sine.periods:
        return f"a constant command, thrust {1e3 * played.force_n.mean():.1f} mN."
    during = (played.time_s > 0) & (played.time_s < played.duration_s)
    force_n, phase = played.force_n[during], played.frequency_rad_s * played.time_s[during]
    columns = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    values = np.linalg.lstsq(columns, force_n, rcond=None)[0]
    amplitude_n = float(np.hypot(values[1], values[2]))
    std_n = float(np.std(force_n - columns @ values)) * (2 / len(force_n)) ** 0.5
    if amplitude_n < _FELT * std_n:
        raise FitError(
            f"the load cell does not measure it: {1e3 * amplitude_n:.2g} mN at its frequency, noise {1e3 * std_n:.2g} "
            "mN. Is it this motor's channel? A larger amplitude or a slower sine shows more."
        )
    left_out = (
        f" Above the cut-off of {CUTOFF_HZ:g} Hz: `cfid tf identify` leaves it out."
        if played.sine.is_above(CUTOFF_HZ)
        else ""
    )
    return f"{1e3 * amplitude_n:.3g} mN at its frequency, {amplitude_n / std_n:.0f} times the noise there.{left_out}"
