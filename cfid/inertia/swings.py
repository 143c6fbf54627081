"""Several swings measured one after the other, ready to be made an inertia of."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.options import WindowOptions
from cfid.errors import ConfigError, FitError
from cfid.swing.data import FIXTURE, KnownInertia, Named
from cfid.swing.result import doubts_of
from cfid.swing.window import check_peaks, find

if TYPE_CHECKING:
    from cfid.records.parameters import Source
    from cfid.swing.axis_inertias import MountedSwing
    from cfid.swing.free_swing import FreeSwing


@dataclass(frozen=True, kw_only=True)
class SwingSet:
    """Measured swings by mount, that of the empty fixture apart, and what is to be said of each."""

    mounted: "list[MountedSwing]"
    fixture: "MountedSwing | None"
    quality: list[dict[str, Any]]
    warnings: tuple[str, ...]
    doubts: tuple[str, ...]
    sources: "tuple[Source, ...]"
    files: tuple[Path, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """What a person reads of each swing."""
        return tuple(_line(quality) for quality in self.quality)


def measure_all(items: Sequence[Named | KnownInertia], window: WindowOptions, method: str) -> SwingSet:
    """Fit every recording and take the known axis inertias as they are.

    Raises DataError and FitError naming the file, ConfigError for a second fixture.
    """
    names = [item.name for item in items]
    if names.count(FIXTURE) > 1:
        raise ConfigError("more than one swing of the empty fixture: give one.")
    check_peaks(window.peaks, names)
    measured = [_measure(item, window, method) for item in items]
    files = [item.record for item in items if isinstance(item, Named)]
    return SwingSet(
        mounted=[swing for swing, *_ in measured if swing.axis != FIXTURE],
        fixture=next((swing for swing, *_ in measured if swing.axis == FIXTURE), None),
        quality=[quality for _, quality, *_ in measured],
        warnings=tuple(note for file in files for note in file.notes) + tuple(w for m in measured for w in m[2]),
        doubts=tuple(doubt for m in measured for doubt in m[3]),
        sources=tuple(file.source for file in files),
        files=tuple(file.path for file in files),
    )


def _line(quality: dict[str, Any]) -> str:
    if "known_kg_m2" in quality:
        return f"{quality['axis']}: {quality['known_kg_m2']:.7g} kg m^2, as given"
    words = f"{quality['axis']}: W {quality['natural_frequency_squared_s2']:.7g} 1/s^2, {quality['peaks_used']} peaks"
    if "damping_terms" not in quality:
        return f"{words}, damped cosine"
    return f"{words}, waveform off by {100 * quality['distortion']:.2g} %, drift {100 * quality['drift']:+.2g} %"


def _measure(
    item: Named | KnownInertia, window: WindowOptions, method: str
) -> "tuple[MountedSwing, dict[str, Any], tuple[str, ...], tuple[str, ...]]":
    from cfid.swing.axis_inertias import MountedSwing

    if isinstance(item, KnownInertia):
        known = MountedSwing(axis=item.name, value=item.value_kg_m2, std=item.std_kg_m2, known=True)
        return known, {"axis": item.name, "known_kg_m2": item.value_kg_m2}, (), ()
    swing = find(item.record, window, axis=item.name)
    try:
        value, std, quality, warnings, doubts = (_thesis if method == "thesis" else _default)(swing)
    except FitError as error:
        raise FitError(f"{item.record.path}: {error}") from None
    named = tuple(f"{item.name}: {doubt}" for doubt in doubts)
    said = tuple(f"{item.name}: {warning}" for warning in warnings)
    quality = {"axis": item.name, "natural_frequency_squared_s2": value, "std_s2": std, **quality}
    return MountedSwing(axis=item.name, value=value, std=std), quality, said, named


def _default(swing: "FreeSwing") -> tuple[float, float, dict[str, Any], tuple[str, ...], tuple[str, ...]]:
    from cfid.swing.estimation import fit_swing

    fit = fit_swing(swing)
    quality = {
        "believed": fit.believed,
        "peaks_used": swing.peaks_used,
        "damping_terms": fit.terms,
        "rms": fit.residual_rms_rad,
        "distortion": fit.verdict.distortion,
        "drift": fit.verdict.drift,
    }
    frequency = fit.coefficients.natural_frequency_squared_s2
    # Which damping terms explain the decay does not matter for an inertia: the split's warning stays out.
    return frequency, fit.std.natural_frequency_squared_s2, quality, swing.warnings, fit.verdict.doubts


def _thesis(swing: "FreeSwing") -> tuple[float, float, dict[str, Any], tuple[str, ...], tuple[str, ...]]:
    from cfid.swing.thesis import fit_damped_cosine

    cosine = fit_damped_cosine(swing)
    quality = {"peaks_used": swing.peaks_used}
    frequency, std = (found.natural_frequency_squared_s2 for found in (cosine.frequencies, cosine.std))
    return frequency, std, quality, swing.warnings, doubts_of(swing)
