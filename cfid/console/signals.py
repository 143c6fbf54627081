"""Judge a few seconds of real signals, with motors off: rate, losses, noise and drift at rest, and the battery.

The limits are those of rig.toml's table [check].
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from cfid.console.live import LiveLine
from cfid.console.messages import clock, note
from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.estimate.battery_endurance import CELL_MAH, Held, endurance
from cfid.records.rig_file import CheckLimits
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer, State
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument
from cfid.rig.recorder import Sampled
from cfid.rig.run import sample
from cfid.rig.vehicle import BATTERY
from cfid.wire.rls import turns_of

Array = npt.NDArray[np.float64]
Answers = dict[str, list[DeviceAnswer]]  # by device

NOT_READ = "; battery not read"  # shown where `no_preflight` skips the look

_AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
_FEWEST = 3  # rows of a device, of which a slow one sends few
_BLOCKS = 20  # for a drift, so that slow noise does not count as many independent samples
_SURE = 3.0  # standard uncertainties by which a drift has to exceed its limit
_TARE_S = 0.2  # the live line shows forces relative to those at the start, as in a recording
_QUICK_S = 1.0
_WORTHLESS = {"load", "rate", "losses"}  # faults of a load cell that make a recording useless
_CHARGE = "charge"


def look(instruments: Sequence[Instrument], hardware: Hardware, *, for_s: float) -> dict[str, Sampled]:
    """Sample instruments for some seconds, a slow one until it has sent enough; return each by its name.

    Raises DeviceError where one fails.
    """
    slowest_hz = min(instrument.record.rate_hz or math.inf for instrument in instruments)
    live = LiveLine()
    live.task("looking at the signals")
    try:
        return sample(
            instruments, hardware, for_s=max(for_s, (_FEWEST + 1) / slowest_hz), tare_s=_TARE_S, show=live.show
        )
    finally:
        live.end()


def judged(
    records: Mapping[str, DeviceRecord],
    sampled: Mapping[str, Sampled],
    limits: CheckLimits,
    *,
    plan: Sequence[Held] = (),
    supply: bool,
    calm: bool = True,
) -> Answers:
    """Return the answers about each device that was sampled.

    The battery has to last for the `plan`, if there is one; the voltage of a `supply` has no limit. In wind, which is
    not `calm`, a load cell's noise and drift have no limit.
    """
    answers: Answers = {}
    for name, record in records.items():
        device = sampled[name]
        if device.rows < _FEWEST:
            advice = "check its power, its cable and its table in rig.toml; `cfid rig check` shows what it sends"
            answers[name] = [
                _answer("rate", counted(device.rows, "sample"), f"{_FEWEST} samples", advice, within=False)
            ]
            continue
        answers[name] = _rate(record, device, limits)
        if name == "encoder":
            answers[name] += _angle_at_rest(record, device, limits)
        elif name == "loadcell":
            answers[name] += _load_at_rest(record, device, limits, calm=calm)
        elif BATTERY in device.columns:
            volts = float(np.median(device.columns[BATTERY]))
            answers[name].append(_charge(volts, limits, plan, supply=supply))
    return answers


def quick(
    devices: Callable[[], Sequence[Instrument]],
    plan: Sequence[Held],
    hardware: Hardware,
    limits: CheckLimits,
    *,
    supply: bool,
    calm: bool = True,
) -> str:
    """Look at load cell and vehicle for one second, note each exceeded limit, and return the battery's state.

    `devices` returns them, anew for each look. Raises DeviceError where a device failed, or where two looks agree that
    a recording would be worthless; one look is not enough, since a busy computer may have missed samples.
    """
    for _ in range(2):
        instruments = devices()
        records = {instrument.name: instrument.record for instrument in instruments}
        sampled = look(instruments, hardware, for_s=_QUICK_S)
        answers = judged(records, sampled, limits, plan=plan, supply=supply, calm=calm)
        faults = {answer.asked for answer in answers.get("loadcell", ()) if answer.state == "fault"}
        if not faults & _WORTHLESS:
            break
    facts = [(name, answer) for name, device_answers in answers.items() for answer in device_answers]
    lines = [
        f"{name}, {answer.asked}: {answer.answer} (limit {answer.limit}): {answer.advice}."
        for name, answer in facts
        if answer.state != "ok"
    ]
    if faults & _WORTHLESS:
        raise DeviceError(f"not recorded: {' '.join(lines)} `no_preflight` records nevertheless.")
    for line in lines:
        note(line)
    source = "" if supply else "battery "
    return next((f"; {source}{answer.answer}" for _, answer in facts if answer.asked == _CHARGE), "")


def _rate(record: DeviceRecord, sampled: Sampled, limits: CheckLimits) -> list[DeviceAnswer]:
    count, advice = sampled.rows + (sampled.lost or 0), "use a direct cable, or move the antenna nearer"
    share = math.inf if sampled.lost is None else sampled.lost / count
    lost = "unknown: more samples than the stated rate" if sampled.lost is None else f"{share:.2%} of {count} samples"
    losses = _answer("losses", lost, f"{limits.losses:.2%}", advice, within=share <= limits.losses)
    rate_hz = (record.model_extra or {}).get("settings", {}).get("rate_hz", record.rate_hz)
    if rate_hz is None:
        return [losses]
    achieved_hz = (count - 1) / float(np.ptp(sampled.columns["t"]))
    # The span of a few samples is uncertain by a fraction of a period.
    least_hz = rate_hz * (limits.rate - (1 / count if count < 64 else 0.0))
    advice = "end other programs on this computer, or request fewer samples (rate_hz in rig.toml)"
    rate = _answer("rate", f"{achieved_hz:.4g} Hz", f"{least_hz:.4g} Hz", advice, within=achieved_hz >= least_hz)
    return [rate, losses]


def _angle_at_rest(record: DeviceRecord, sampled: Sampled, limits: CheckLimits) -> list[DeviceAnswer]:
    """Judge noise, with a warning at most, since a pendulum may swing, as the simulated one does, and drift."""
    in_radians = (record.model_extra or {}).get("angle_unit") == "rad"
    counts_per_turn = math.tau if in_radians else record.counts_per_turn or math.nan
    degrees = np.unwrap(360 * turns_of(sampled.columns["phi"], counts_per_turn).turns, period=360)
    _, drift, sure = _noise_and_drift(degrees[:, np.newaxis])
    moved, advice = float(np.ptp(degrees)), "let the pendulum hang still, and nothing touch it"
    return [
        _answer("noise", f"{moved:.2g} degrees between extremes", f"{limits.noise_deg:g}", advice,
                within=moved <= limits.noise_deg, beyond="warning"),
        _answer("drift", f"{drift[0]:.2g} degrees", f"{limits.drift_deg:g}", advice,
                within=sure[0] <= limits.drift_deg),
    ]  # fmt: skip


def _load_at_rest(record: DeviceRecord, sampled: Sampled, limits: CheckLimits, *, calm: bool) -> list[DeviceAnswer]:
    """Judge load, noise and drift by the range of each axis; a device that sends lines has neither range nor limits."""
    axes = [axis for axis in _AXES if axis in sampled.columns]
    values = np.column_stack([sampled.columns[axis] for axis in axes])
    noise, drift, sure_drift = _noise_and_drift(values)
    quieter = "look for vibration, mains adapters, a draught, or a cable that touches the vehicle"
    warmer = "let the cell warm up for half an hour, and keep draughts and hands away"
    facts = [("noise", noise, noise, limits.noise, quieter), ("drift", drift, sure_drift, limits.drift, warmer)]
    extra = record.model_extra or {}
    ranges, milli = np.full(len(axes), np.inf), np.full(len(axes), 1e3)
    if settings := extra.get("settings"):
        ranges = settings["ranges"] * np.repeat([settings["counts_per_force"], settings["counts_per_torque"]], 3)
        milli = 1e3 / np.repeat([extra["counts_per_n"], extra["counts_per_nm"]], 3)
        load = np.max(np.abs(values), axis=0)
        lower = "take load off, or mount the vehicle lower: beyond its range the cell shows no forces"
        facts.insert(0, ("load", load, load, limits.load, lower))
    answers = []
    for asked, sizes, judged_sizes, limit, advice in facts:
        worst = int(np.argmax(judged_sizes / ranges))
        size = f"{axes[worst]} {sizes[worst] * milli[worst]:.2g} {'mN' if axes[worst].startswith('F') else 'mNm'}"
        if settings:
            size += f", {sizes[worst] / ranges[worst]:.2%} of its range"
        has_limit = bool(settings) and (calm or asked == "load")
        within = not has_limit or bool(judged_sizes[worst] <= limit * ranges[worst])
        answers.append(_answer(asked, size, f"{limit:.2%}" if has_limit else "", advice, within=within))
    return answers


def _noise_and_drift(values: Array) -> tuple[Array, Array, Array]:
    """Return each column's (n, k) standard deviation about a line, the change of the line, and the sure part of it."""
    blocks = np.array([part.mean(axis=0) for part in np.array_split(values, min(_BLOCKS, len(values)))])
    place = (np.arange(len(blocks)) + 0.5) / len(blocks) - 0.5
    slope, middle = np.polyfit(place, blocks, 1)
    off = blocks - np.outer(place, slope) - middle
    std = np.sqrt((off**2).sum(axis=0) / (len(blocks) - 2) / (place @ place))
    residual = values - np.outer((np.arange(len(values)) + 0.5) / len(values) - 0.5, slope)
    return residual.std(axis=0), np.abs(slope), np.maximum(np.abs(slope) - _SURE * std, 0.0)


def _charge(volts: float, limits: CheckLimits, plan: Sequence[Held], *, supply: bool) -> DeviceAnswer:
    """Judge a battery by its voltage, and by how long it lasts; a warning at most."""
    if supply:
        return _answer(_CHARGE, f"{volts:.2f} V of a supply", "", "", within=True)
    lasting = endurance(volts, plan) if plan else None
    answer, limit, within = f"{volts:.2f} V", f"{limits.battery_v:g} V", volts >= limits.battery_v
    if lasting is not None:
        answer = f"{answer}: about {lasting.charge:.0%}, lasts {clock(lasting.lasts_s)} min at this plan's currents"
        limit, within = f"{clock(lasting.takes_s)} min, on a cell of {CELL_MAH:g} mAh", lasting.enough
    return _answer(_CHARGE, answer, limit, "charge it, or record in parts", within=within, beyond="warning")


def _answer(asked: str, answer: str, limit: str, advice: str, *, within: bool, beyond: State = "fault") -> DeviceAnswer:
    return DeviceAnswer(asked, "ok" if within else beyond, answer, "" if within else advice, limit)
