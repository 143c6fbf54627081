"""Judge a few seconds of real signals against limits before a recording of minutes: rig at rest, motors off."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from cfid.console.messages import clock
from cfid.console.preflight_lines import angle_steps, force_steps, sends_lines
from cfid.counted import counted
from cfid.estimate.battery_endurance import CELL_MAH, Held, endurance
from cfid.estimate.held_readings import rows_a_reading
from cfid.estimate.signals import SignalQuality, signal_quality
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer, State
from cfid.rig.recorder import Sampled
from cfid.rig.vehicle import BATTERY
from cfid.wire.rls import turns_of

Array = npt.NDArray[np.float64]

LASTS = "battery lasts"
TARE_S = 0.2  # the live line shows forces relative to those at the start, as in a recording

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")

# Fractions of each axis' range: a cell's own noise is several times smaller, its resolution ten times.
_NOISE, _DRIFT, _LINE, _LOAD = 1e-3, 2e-4, 2.5e-4, 0.8
_SURE = 3.0  # how many standard uncertainties a drift has to exceed its limit by
_SLOWEST, _MOST_LOST = 0.95, 0.01  # fraction of the requested rate; fraction of the samples
_STILL_DEG, _TURNED_DEG = 0.5, 0.2  # of a pendulum at rest: between its extremes, and by drift
_RETURNS, _OUTER = 4, 0.2  # passes of a swing through its middle; the middle, as a fraction of its range
_SMOOTH = 0.5  # correlation of neighbouring samples of a swing
_STAMPS_S = 0.005  # scatter of the delays between a sample's timestamp and its arrival
_FEWEST = 64
FEWEST_LINES = 3  # of a device whose stated rate is low


def of_loadcell(record: DeviceRecord, sampled: Sampled, *, calm: bool = True) -> list[DeviceAnswer]:
    """Judge a Net F/T's signals. In wind, which is not `calm`, noise, drift and spectral lines have no limit."""
    if sampled.rows < _FEWEST:
        return [
            _answer("rate", counted(sampled.rows, "sample"), "check power and cable", limit=f"{_FEWEST}", within=False)
        ]
    settings = (record.model_extra or {})["settings"]
    per_unit = np.repeat([settings["counts_per_force"], settings["counts_per_torque"]], 3)
    milli = 1e3 / np.repeat([(record.model_extra or {})[key] for key in ("counts_per_n", "counts_per_nm")], 3)
    largest = np.array(settings["ranges"]) * per_unit
    counts = np.column_stack([sampled.columns[axis] for axis in AXES])
    loaded = np.max(np.abs(counts), axis=0) / largest
    worst = int(np.argmax(loaded))
    answers = [
        *_rate(sampled, float(settings["rate_hz"])),
        _answer(
            "load",
            f"{100 * loaded[worst]:.0f} % of {AXES[worst]}'s range",
            "take load off, or mount the vehicle lower: beyond its range the cell shows no forces",
            limit=f"{100 * _LOAD:.0f} %",
            within=bool(loaded[worst] <= _LOAD),
        ),
    ]
    rate_hz = (sampled.rows - 1) / float(np.ptp(sampled.columns["t"]))
    found = [signal_quality(counts[:, axis], rate_hz=rate_hz) for axis in range(6)]
    noise, drift, lines = ((part * largest * milli if calm else None) for part in (_NOISE, _DRIFT, _LINE))
    return [
        *answers,
        _six("noise", milli * [one.noise_std for one in found], noise, _QUIETER),
        _six(
            "drift", milli * [abs(one.drift) for one in found], drift, _WARMER, sure=milli * [*map(_sure_drift, found)]
        ),
        _six("mains", milli * [one.mains for one in found], lines, _EARTHED),
        _six("other lines", milli * [one.line for one in found], lines, _STIFFER, more=_where(found)),
    ]


def _of_lines(record: DeviceRecord, sampled: Sampled, plan: Sequence[Held], *, mass_kg: float) -> list[DeviceAnswer]:
    """Judge a load cell that sends text lines, by its stated rate and the steps of its values."""
    if sampled.rows < FEWEST_LINES:
        advice = (
            "compare baud, pattern and values of devices.loadcell in rig.toml with what it sends: `cfid rig check` "
            "shows a line, and which tables have the same port"
            if (sampled.lost or 0) > sampled.rows
            else f"check power and cable, or look for longer (--for): it states {record.rate_hz:g} Hz"
        )
        return [_answer("rate", counted(sampled.rows, "sample"), advice, limit=f"{FEWEST_LINES}", within=False)]
    return [*_rate(sampled, record.rate_hz or math.nan), *force_steps(record, sampled, plan, mass_kg=mass_kg)]


_CALMER = "mend the noise first, or look for longer (--for)"
_QUIETER = "look for vibration, a draught, or a cable that touches the vehicle; check the cell's shield"
_WARMER = "let the cell warm up for half an hour, and keep draughts and hands away"
_EARTHED = "earth the rig, and move mains adapters, fans and pumps away from it"
_STIFFER = "something vibrates at this frequency: tighten the stand, decouple it, switch the source off"


def _sure_drift(one: SignalQuality) -> float:
    """Return the part of a drift that noise does not explain."""
    return max(abs(one.drift) - _SURE * one.drift_std, 0.0)


def _where(found: Sequence[SignalQuality]) -> str:
    clear = [one for one in found if math.isfinite(one.line_hz)]
    if not clear:
        return ", none clear of the noise"
    return f", the clearest at {max(clear, key=lambda one: one.line / one.noise_std).line_hz:.0f} Hz"


def _six(
    line: str, values: Array, limits: Array | None, advice: str, *, sure: Array | None = None, more: str = ""
) -> DeviceAnswer:
    """Judge one value per axis, in mN and mNm, by its `sure` part where noise explains the rest."""
    most = "" if limits is None else _in_milli(limits)
    sure = values if sure is None else sure
    within = True if limits is None else _within(values, sure, limits)
    return _answer(line, _in_milli(values) + more, advice, limit=most, within=within)


def _within(values: Array | float, sure: Array | float, limits: Array | float) -> bool | None:
    """Return whether values are within limits, None where noise hides it: the `sure` part is within, the whole not."""
    if np.all(values <= limits):
        return True
    return False if np.any(sure > limits) else None


def _in_milli(values: Array) -> str:
    force, torque = (", ".join(f"{value:.2g}" for value in part) for part in (values[:3], values[3:]))
    return f"{force} mN; {torque} mNm"


def of_encoder(record: DeviceRecord, sampled: Sampled) -> list[DeviceAnswer]:
    """Judge the encoder of a pendulum at rest: rate, losses, timestamps, noise and drift."""
    if sampled.rows < _FEWEST:
        return [_answer("rate", counted(sampled.rows, "sample"), "check the cable", limit=f"{_FEWEST}", within=False)]
    in_radians = (record.model_extra or {}).get("angle_unit") == "rad"
    degrees = _degrees(sampled.columns["phi"], math.tau if in_radians else record.counts_per_turn or math.nan)
    rate_hz = (sampled.rows - 1) / float(np.ptp(sampled.columns["t"]))
    steps = [angle_steps(record, sampled, swings=_swings(degrees))] if sends_lines(record) else []
    rate = [*_rate(sampled, record.rate_hz or rate_hz), *_readings(degrees, rate_hz)]
    answers = [*rate, *steps, *_at_rest(degrees, rate_hz)]
    if "device_us" not in sampled.columns:
        return [*answers, DeviceAnswer("stamps", "ok", "none: samples are placed by their arrival")]
    late_s = sampled.columns["t"] - 1e-6 * sampled.columns["device_us"]
    late_s -= np.polyval(np.polyfit(np.arange(len(late_s)), late_s, 1), np.arange(len(late_s)))
    scatter_s = float(late_s.std())
    advice = "the computer is busy or the hub shared: end other programs, plug the interface in directly"
    within = scatter_s <= _STAMPS_S
    shown = f"arrivals scatter {1e3 * scatter_s:.2g} ms about the device's stamps"
    return [*answers, _answer("stamps", shown, advice, limit=f"{1e3 * _STAMPS_S:g} ms", within=within)]


def _readings(degrees: Array, rate_hz: float) -> list[DeviceAnswer]:
    """Report repeated readings of an angle (n,); a coarse encoder at rest repeats its reading anyway."""
    rows = rows_a_reading(degrees)
    if rows == 1:
        return []
    shown = f"each repeated in about {rows} samples: {rate_hz / rows:.3g} a second"
    advice = "send a line only where the sensor has a new reading, and state that rate in rig.toml"
    return [DeviceAnswer("readings", "warning", shown, advice, f"{rate_hz:.0f} a second")]


def _at_rest(degrees: Array, rate_hz: float) -> list[DeviceAnswer]:
    """Judge noise and drift of an angle (n,) at rest; a swing hides both, but is no fault of the rig."""
    quality, moved = signal_quality(degrees, rate_hz=rate_hz), float(np.ptp(degrees))
    if _swings(degrees):
        hint = "hold it still and check again: noise and drift are judged at rest"
        return [
            DeviceAnswer("at rest", "warning", f"it swings by {moved:.3g} degrees", hint, f"{_STILL_DEG:g} degrees")
        ]
    still = "let the pendulum hang still, and nothing touch it"
    return [
        _answer(
            "noise",
            f"{quality.noise_std:.3f} degrees, {moved:.2f} between extremes",
            still,
            limit=f"{_STILL_DEG:g} degrees between extremes",
            within=moved <= _STILL_DEG,
        ),
        _answer(
            "drift",
            f"{abs(quality.drift):.2g} degrees",
            f"{still}; a cable that relaxes turns it",
            limit=f"{_TURNED_DEG:g} degrees",
            within=_within(abs(quality.drift), _sure_drift(quality), _TURNED_DEG),
        ),
    ]


def _swings(degrees: Array) -> bool:
    """Return whether an angle (n,) oscillates about its linear trend; noise jumps, and drift does not return."""
    if np.ptp(degrees) <= _STILL_DEG:
        return False
    place = np.arange(len(degrees))
    off = degrees - np.polyval(np.polyfit(place, degrees, 1), place)
    outer = off[np.abs(off) > _OUTER * np.ptp(off)]  # excludes noise about the middle
    returns = np.count_nonzero(np.diff(np.sign(outer)))
    alike = float(off[1:] @ off[:-1]) / float(off @ off)
    return bool(np.ptp(off) > _STILL_DEG and returns >= _RETURNS and alike > _SMOOTH)


def _degrees(counts: Array, counts_per_turn: float | str) -> Array:
    """Return a continuous angle (n,) in degrees, relative to its first value."""
    degrees = np.unwrap(360 * turns_of(counts, counts_per_turn).turns, period=360)
    return np.asarray(degrees - degrees[0])


def _rate(sampled: Sampled, requested_hz: float) -> list[DeviceAnswer]:
    count = sampled.rows + (sampled.lost or 0)
    achieved_hz = (count - 1) / float(np.ptp(sampled.columns["t"]))
    share = math.inf if sampled.lost is None else sampled.lost / count
    # The span of a few samples is uncertain by a fraction of a period.
    least_hz = requested_hz * (_SLOWEST - (1 / sampled.rows if sampled.rows < _FEWEST else 0.0))
    return [
        _answer(
            "rate",
            f"{achieved_hz:.3g} Hz" if requested_hz < _FEWEST else f"{achieved_hz:.0f} Hz",
            "end other programs on this computer, or request fewer samples (rate_hz in rig.toml)",
            limit=f"{least_hz:.3g} Hz" if requested_hz < _FEWEST else f"{least_hz:.0f} Hz",
            within=achieved_hz >= least_hz,
        ),
        _answer(
            "losses",
            "unknown: more samples than the stated rate"
            if sampled.lost is None
            else f"{100 * share:.2g} % of {count} samples",
            "use a direct cable, end other programs, and compare rate_hz in rig.toml with the rate of the device's "
            "program; `cfid rig check` names what it finds of the device",
            limit=f"{100 * _MOST_LOST:g} %",
            within=share <= _MOST_LOST,
        ),
    ]


def of_vehicle(sampled: Sampled, plan: Sequence[Held]) -> list[DeviceAnswer]:
    """Judge the vehicle's log: the radio losses, and whether the battery lasts for a plan."""
    count = sampled.rows + (sampled.lost or 0)
    lost = (sampled.lost or 0) / max(count, 1)
    radio = _answer(
        "radio losses",
        f"{100 * lost:.2g} % of {count} rows",
        "move the antenna nearer, or change the channel; a slower log (--log-ms) needs less",
        limit=f"{100 * _MOST_LOST:g} %",
        within=bool(sampled.rows) and lost <= _MOST_LOST,
    )
    return [radio, battery(sampled, plan)]


def battery(sampled: Sampled, plan: Sequence[Held]) -> DeviceAnswer:
    """Return the battery's voltage and how long it lasts; too short is only a warning, as the cell may differ."""
    if BATTERY not in sampled.columns:
        return DeviceAnswer(LASTS, "warning", "the vehicle reports no voltage", "charge it before long recordings")
    volts = float(np.median(sampled.columns[BATTERY]))
    found = endurance(volts, plan)
    if found is None:
        return DeviceAnswer(LASTS, "ok", f"{volts:.2f} V, which is no single lithium cell")
    shown = f"{volts:.2f} V: about {100 * found.charge:.0f} %, lasts {clock(found.lasts_s)} min at this plan's currents"
    takes = f"{clock(found.takes_s)} min, on a cell of {CELL_MAH:g} mAh"
    if found.enough:
        return DeviceAnswer(LASTS, "ok", shown, limit=takes)
    return DeviceAnswer(
        LASTS,
        "warning",
        shown,
        "charge it, or record in parts with --resume; a supply does not run empty",
        takes,
    )


def judged(
    records: Mapping[str, DeviceRecord],
    sampled: Mapping[str, Sampled],
    plan: Sequence[Held],
    *,
    mass_kg: float,
    calm: bool = True,
) -> dict[str, list[DeviceAnswer]]:
    """Return the answers about each device that was sampled; `mass_kg` is the vehicle's."""
    answers: dict[str, list[DeviceAnswer]] = {}
    for name, record in records.items():
        if name == "loadcell" and sends_lines(record):
            answers[name] = _of_lines(record, sampled[name], plan, mass_kg=mass_kg)
        elif name == "loadcell":
            answers[name] = of_loadcell(record, sampled[name], calm=calm)
        elif name == "encoder":
            answers[name] = of_encoder(record, sampled[name])
        elif name == "crazyflie":
            answers[name] = of_vehicle(sampled[name], plan)
    return answers


def _answer(line: str, answer: str, advice: str, *, limit: str, within: bool | None) -> DeviceAnswer:
    """Return an answer for a line of the preflight; where noise hides the verdict (None), it is not judged."""
    if within is None:
        return DeviceAnswer(line, "warning", f"{answer}, not judged: noise hides it", _CALMER, limit)
    state: State = "ok" if within else "fault"
    return DeviceAnswer(line, state, answer, "" if within else advice, limit)
