"""Swings of one body about several mounts, each measured, from which inertias can be calculated."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding
from cfid.recordings.angle import AngleSource, AxisRecord
from cfid.recordings.periods import axis_record
from cfid.records.parameters import Source
from cfid.records.plausibility import taken_as_exact
from cfid.records.result import Dependent
from cfid.records.rig_file import Rig
from cfid.swing.body import (
    FIXTURE,
    AxisInertias,
    KnownInertia,
    Measured,
    MountedSwing,
    Surroundings,
    axis_inertias,
    body_on,
    contradicted_axes,
    required_rig,
    surroundings,
    threads_of,
)
from cfid.swing.estimation import SwingFit
from cfid.swing.result import FREQUENCY, Method, estimate
from cfid.swing.window import FreeSwing, check_peaks, peaks_on

Swing = AngleSource | KnownInertia
Peaks = int | Mapping[str, int] | None


@dataclass(frozen=True, kw_only=True)
class MeasuredSwings:
    """All swings of a body and their axis inertias, and figures of merit, lines and findings by mount.

    `example` is the first recorded swing with its fit, to be drawn; None without one.
    """

    rig: Rig
    around: Surroundings
    axes: AxisInertias
    merits: tuple[dict[str, Any], ...]
    lines: tuple[str | Dependent, ...]
    found: tuple[tuple[str, Finding], ...]
    records: tuple[AxisRecord, ...]
    example: tuple[str, FreeSwing, SwingFit] | None = None

    @property
    def mounts(self) -> list[str]:
        """The mount of each swing."""
        return [swing.axis for swing in self.axes.swings]

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files of the recordings."""
        return tuple(record.source for record in self.records)

    def findings(self, resting_on: Callable[[str], tuple[str, ...]]) -> tuple[Finding, ...]:
        """Return the findings about recordings and swings; `resting_on` returns the quantities that rest on a mount."""
        mounts = dict[Finding, dict[str, None]]()
        for mount, finding in self.found:
            mounts.setdefault(finding, {})[mount] = None
        return (
            *(finding for record in self.records for finding in record.findings),
            *(
                replace(
                    finding, where=tuple(names), quantities=tuple(key for name in names for key in resting_on(name))
                )
                for finding, names in mounts.items()
            ),
        )


def measure(
    given: Sequence[Swing],
    *,
    body: str,
    gives: str,
    rig: Rig | None,
    mass: Measured,
    gravity: Measured,
    peaks: Peaks,
    smallest_peak_rad: float,
    method: Method,
) -> MeasuredSwings:
    """Fit every recording of a body, on the mount that its label names; known axis inertias are kept.

    `gives` is the key, without the mount, of the quantity that a swing gives. A given mass and gravity, each with its
    standard uncertainty, replace those of the rig, which is that of the recordings' campaign where none is given.

    Raises DataError and FitError naming the file, ConfigError for no swing, no rig, an unknown mount, a second fixture
    or another body's swing.
    """
    if not given:
        raise ConfigError("no swing is given: name at least one run or file.")
    swings = [swing if isinstance(swing, KnownInertia) else axis_record(swing) for swing in given]
    records = [swing for swing in swings if isinstance(swing, AxisRecord)]
    rig = required_rig(records, rig)
    names = [swing.mount if isinstance(swing, KnownInertia) else _mount_of(swing, body) for swing in swings]
    if names.count(FIXTURE) > 1:
        raise ConfigError("more than one swing of the empty fixture: give one.")
    check_peaks(peaks, names)
    hung = body_on(rig, [name for name in names if name != FIXTURE], body=body, mass=mass)
    gravity_mps2 = surroundings(rig, *gravity).gravity_mps2
    mounted, merits, lines, found = [], list[dict[str, Any]](), list[str | Dependent](), []
    example: tuple[str, FreeSwing, SwingFit] | None = None
    for mount, swing in zip(names, swings, strict=True):
        if isinstance(swing, KnownInertia):
            mounted.append(MountedSwing(axis=mount, value=swing.value_kg_m2, std=swing.std_kg_m2, known=True))
            merits.append({"axis": mount, "known_kg_m2": swing.value_kg_m2})
            lines.append(f"{mount}: {swing.value_kg_m2:.7g} kg m^2, as given")
            found += [] if swing.std_kg_m2 else [(mount, taken_as_exact("axis inertia"))]
            continue
        threads = threads_of(hung.mounts.get(mount), gravity_mps2)
        window = {"peaks": peaks_on(mount, peaks), "smallest_peak_rad": smallest_peak_rad}
        fitted = estimate(swing, threads, rig.encoder, method=method, **window)
        if example is None and fitted.window is not None and isinstance(fitted.fitted, SwingFit):
            example = swing.name, fitted.window, fitted.fitted
        value, std = fitted.frequency
        mounted.append(replace(fitted.mounted(mount), name=swing.name))
        key = f"{gives}.{mount}"
        frequency = {"natural_frequency_squared_s2": Dependent(value, key), "std_s2": Dependent(std, key)}
        merits.append({"axis": mount, **frequency, **fitted.merits})
        line = f"{mount}: natural frequency squared {value:.7g} 1/s^2, {fitted.line}"
        lines.append(Dependent(line, key, instead=f"{mount}: rejected, {fitted.line}"))
        found += [(mount, finding) for finding in fitted.findings if finding.concerns(FREQUENCY)]
    around = surroundings(rig, *gravity, next((swing for swing in mounted if swing.axis == FIXTURE), None))
    return MeasuredSwings(
        rig=rig,
        around=around,
        axes=axis_inertias([swing for swing in mounted if swing.axis != FIXTURE], hung, around),
        merits=tuple(merits),
        lines=tuple(lines),
        found=(*found, *contradicted_axes(hung, records)),
        records=tuple(records),
        example=example,
    )


def _mount_of(record: AxisRecord, body: str) -> str:
    """Return the mount that a recording's label names; one labelled as the fixture belongs to it, whatever its axis."""
    label = record.label
    if label.body == FIXTURE:
        return FIXTURE
    if label.body is not None and label.body != body:
        raise ConfigError(f"{record.name}: is labelled as a swing of the {label.body}, not of the {body}.")
    if label.axis is None:
        raise DataError(f"{record.name}: has no axis in its label: name it, as in AXIS={record.name}.")
    return label.axis
