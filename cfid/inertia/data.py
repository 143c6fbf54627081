"""Swings of one body about several mounts, each measured, ready to be made an inertia of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cfid.errors import ConfigError, DataError, FitError
from cfid.findings import Finding, warning
from cfid.records.parameters import Source
from cfid.records.tables.angle import AngleRecord, Recording, angle_record
from cfid.swing.axis_inertias import MountedSwing
from cfid.swing.data import FIXTURE, KnownInertia, check_peaks, peaks_on, swing_in
from cfid.swing.estimation import fit_swing
from cfid.swing.free_swing import FreeSwing
from cfid.swing.result import Method, rejections_of
from cfid.swing.thesis import fit_damped_cosine

Swing = Recording | KnownInertia
Peaks = int | Mapping[str, int] | None


@dataclass(frozen=True, kw_only=True)
class MeasuredSwing:
    """A swing, or a known axis inertia, with its figures of quality and what was found about it."""

    mounted: MountedSwing
    quality: dict[str, Any]
    findings: tuple[Finding, ...] = ()

    @property
    def line(self) -> str:
        """What a person reads of it."""
        quality, axis = self.quality, self.mounted.axis
        if self.mounted.known:
            return f"{axis}: {self.mounted.value:.7g} kg m^2, as given"
        rejected = any(finding.severity == "rejection" for finding in self.findings)
        frequency = "rejected" if rejected else f"W {self.mounted.value:.7g} 1/s^2"
        line = f"{axis}: {frequency}, {quality['peaks_used']} peaks"
        if "damping_terms" not in quality:
            return f"{line}, damped cosine"
        return f"{line}, waveform off by {100 * quality['distortion']:.2g} %, drift {100 * quality['drift']:+.2g} %"


@dataclass(frozen=True, kw_only=True)
class MeasuredSwings:
    """All swings of a body and of the empty fixture, and the recordings that they come from."""

    swings: tuple[MeasuredSwing, ...]
    records: tuple[AngleRecord, ...]

    @property
    def mounted(self) -> list[MountedSwing]:
        """The swings of the body."""
        return [swing.mounted for swing in self.swings if swing.mounted.axis != FIXTURE]

    @property
    def fixture(self) -> MountedSwing | None:
        """The swing of the empty fixture."""
        return next((swing.mounted for swing in self.swings if swing.mounted.axis == FIXTURE), None)

    @property
    def quality(self) -> list[dict[str, Any]]:
        """Each swing's figures of quality."""
        return [swing.quality for swing in self.swings]

    @property
    def lines(self) -> tuple[str, ...]:
        """What a person reads of each swing."""
        return tuple(swing.line for swing in self.swings)

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files."""
        return tuple(record.source for record in self.records)

    @property
    def folder(self) -> Path:
        """Where the first recording lies."""
        return self.records[0].path.parent if self.records else Path()

    def findings(self, resting_on: Callable[[str], tuple[str, ...]]) -> tuple[Finding, ...]:
        """Return the findings about recordings and swings; `resting_on` has the quantities that rest on a mount."""
        return (
            *(warning("recording", text) for record in self.records for text in record.notes),
            *(
                replace(finding, text=f"{name}: {finding.text}", quantities=resting_on(name))
                for name, swing in ((swing.mounted.axis, swing) for swing in self.swings)
                for finding in swing.findings
            ),
        )


def records_of(swings: Sequence[Swing]) -> list[AngleRecord | KnownInertia]:
    """Read what is not read yet."""
    return [swing if isinstance(swing, KnownInertia) else angle_record(swing) for swing in swings]


def measure(
    swings: Sequence[AngleRecord | KnownInertia], *, body: str, peaks: Peaks, smallest_peak_rad: float, method: Method
) -> MeasuredSwings:
    """Fit every recording of a body, on the mount of its label; known axis inertias stay as they are.

    Raises DataError and FitError naming the file, ConfigError for a second fixture or another body's swing.
    """
    mounts = [swing.mount if isinstance(swing, KnownInertia) else _mount_of(swing, body) for swing in swings]
    if mounts.count(FIXTURE) > 1:
        raise ConfigError("more than one swing of the empty fixture: give one.")
    check_peaks(peaks, mounts)
    measured = []
    for mount, swing in zip(mounts, swings, strict=True):
        if isinstance(swing, KnownInertia):
            measured.append(_known(swing))
            continue
        free = swing_in(swing, peaks=peaks_on(mount, peaks), smallest_peak_rad=smallest_peak_rad)
        try:
            measured.append((_by_thesis if method == "thesis" else _by_default)(mount, free))
        except FitError as error:
            raise FitError(f"{swing.path}: {error}") from None
    records = tuple(swing for swing in swings if isinstance(swing, AngleRecord))
    return MeasuredSwings(swings=tuple(measured), records=records)


def _mount_of(record: AngleRecord, body: str) -> str:
    """Return the mount that a recording's label names; one labelled as the fixture is the fixture's, on any axis."""
    label = record.label
    if label.body == FIXTURE:
        return FIXTURE
    if label.body is not None and label.body != body:
        raise ConfigError(f"{record.name}: is labelled as a swing of the {label.body}, not of the {body}.")
    if label.axis is None:
        raise DataError(f"{record.name}: has no axis in its label: name it, as in AXIS={record.name}.")
    return label.axis


def _known(known: KnownInertia) -> MeasuredSwing:
    mounted = MountedSwing(axis=known.mount, value=known.value_kg_m2, std=known.std_kg_m2, known=True)
    return MeasuredSwing(mounted=mounted, quality={"axis": known.mount, "known_kg_m2": known.value_kg_m2})


def _by_default(mount: str, swing: FreeSwing) -> MeasuredSwing:
    fit = fit_swing(swing)
    quality = {
        "accepted": fit.accepted,
        "peaks_used": swing.peaks_used,
        "damping_terms": fit.terms,
        "rms": fit.residual_rms_rad,
        "distortion": fit.quality.distortion,
        "drift": fit.quality.drift,
    }
    frequency, std = (found.natural_frequency_squared_s2 for found in (fit.coefficients, fit.std))
    # Which damping terms explain the decay does not matter for an inertia: that note is left out.
    return _measured(mount, frequency, std, quality, (*swing.findings, *fit.quality.findings))


def _by_thesis(mount: str, swing: FreeSwing) -> MeasuredSwing:
    cosine = fit_damped_cosine(swing)
    frequency, std = (found.natural_frequency_squared_s2 for found in (cosine.frequencies, cosine.std))
    findings = (*swing.findings, *rejections_of(swing))
    return _measured(mount, frequency, std, {"peaks_used": swing.peaks_used}, findings)


def _measured(
    mount: str, frequency: float, std: float, quality: dict[str, Any], findings: tuple[Finding, ...]
) -> MeasuredSwing:
    return MeasuredSwing(
        mounted=MountedSwing(axis=mount, value=frequency, std=std),
        quality={"axis": mount, "natural_frequency_squared_s2": frequency, "std_s2": std, **quality},
        findings=findings,
    )
