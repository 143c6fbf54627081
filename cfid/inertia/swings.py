"""Several swings measured one after the other, ready to be made an inertia of."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.options import WindowOptions
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, warning
from cfid.swing.data import FIXTURE, KnownInertia, Named
from cfid.swing.result import rejections_of
from cfid.swing.window import check_peaks, find

if TYPE_CHECKING:
    from cfid.records.parameters import Source
    from cfid.swing.axis_inertias import MountedSwing
    from cfid.swing.free_swing import FreeSwing


@dataclass(frozen=True, kw_only=True)
class MeasuredSwing:
    """A swing, or a known axis inertia, with its figures of quality and what was found about it."""

    mounted: "MountedSwing"
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
        words = f"{axis}: {frequency}, {quality['peaks_used']} peaks"
        if "damping_terms" not in quality:
            return f"{words}, damped cosine"
        return f"{words}, waveform off by {100 * quality['distortion']:.2g} %, drift {100 * quality['drift']:+.2g} %"


@dataclass(frozen=True, kw_only=True)
class SwingSet:
    """All swings of a body and of the empty fixture, and the files that they come from."""

    swings: tuple[MeasuredSwing, ...]
    notes: tuple[str, ...]
    sources: "tuple[Source, ...]"
    files: tuple[Path, ...]

    @property
    def mounted(self) -> "list[MountedSwing]":
        """The swings of the body."""
        return [swing.mounted for swing in self.swings if swing.mounted.axis != FIXTURE]

    @property
    def fixture(self) -> "MountedSwing | None":
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

    def findings(self, resting_on: Callable[[str], tuple[str, ...]]) -> tuple[Finding, ...]:
        """Return the findings about recordings and swings; `resting_on` has the quantities that rest on a mount."""
        return (
            *(warning("recording", text) for text in self.notes),
            *(
                replace(finding, text=f"{name}: {finding.text}", quantities=resting_on(name))
                for name, swing in ((swing.mounted.axis, swing) for swing in self.swings)
                for finding in swing.findings
            ),
        )


def measure_all(items: Sequence[Named | KnownInertia], window: WindowOptions, method: str) -> SwingSet:
    """Fit every recording and take the known axis inertias as they are.

    Raises DataError and FitError naming the file, ConfigError for a second fixture.
    """
    names = [item.name for item in items]
    if names.count(FIXTURE) > 1:
        raise ConfigError("more than one swing of the empty fixture: give one.")
    check_peaks(window.peaks, names)
    records = [item.record for item in items if isinstance(item, Named)]
    return SwingSet(
        swings=tuple(_measure(item, window, method) for item in items),
        notes=tuple(note for record in records for note in record.notes),
        sources=tuple(record.source for record in records),
        files=tuple(record.path for record in records),
    )


def _measure(item: Named | KnownInertia, window: WindowOptions, method: str) -> MeasuredSwing:
    from cfid.swing.axis_inertias import MountedSwing

    if isinstance(item, KnownInertia):
        known = MountedSwing(axis=item.name, value=item.value_kg_m2, std=item.std_kg_m2, known=True)
        return MeasuredSwing(mounted=known, quality={"axis": item.name, "known_kg_m2": item.value_kg_m2})
    swing = find(item.record, window, axis=item.name)
    try:
        value, std, quality, rejections = (_thesis if method == "thesis" else _default)(swing)
    except FitError as error:
        raise FitError(f"{item.record.path}: {error}") from None
    return MeasuredSwing(
        mounted=MountedSwing(axis=item.name, value=value, std=std),
        quality={"axis": item.name, "natural_frequency_squared_s2": value, "std_s2": std, **quality},
        # Which damping terms explain the decay does not matter for an inertia: that note is left out.
        findings=(*swing.findings, *rejections),
    )


def _default(swing: "FreeSwing") -> tuple[float, float, dict[str, Any], tuple[Finding, ...]]:
    from cfid.swing.estimation import fit_swing

    fit = fit_swing(swing)
    quality = {
        "accepted": fit.accepted,
        "peaks_used": swing.peaks_used,
        "damping_terms": fit.terms,
        "rms": fit.residual_rms_rad,
        "distortion": fit.quality.distortion,
        "drift": fit.quality.drift,
    }
    frequency = fit.coefficients.natural_frequency_squared_s2
    return frequency, fit.std.natural_frequency_squared_s2, quality, fit.quality.findings


def _thesis(swing: "FreeSwing") -> tuple[float, float, dict[str, Any], tuple[Finding, ...]]:
    from cfid.swing.thesis import fit_damped_cosine

    cosine = fit_damped_cosine(swing)
    quality = {"peaks_used": swing.peaks_used}
    frequency, std = (found.natural_frequency_squared_s2 for found in (cosine.frequencies, cosine.std))
    return frequency, std, quality, rejections_of(swing)
