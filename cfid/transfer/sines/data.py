"""What the words of `cfid tf identify` and `verify` stand for: sine runs of an index or of the campaign, by series."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.facts import assumed
from cfid.console.inputs import Workplace, find_recording
from cfid.console.options import LoadCellOptions, ReadingOptions, YawDeg, finite, positive
from cfid.console.selection import chosen
from cfid.errors import ConfigError, DataError
from cfid.records.facts import LoadCellMount, RigFacts
from cfid.records.tables.index import IndexRow, read_index
from cfid.units import FULL_COMMAND, MM

if TYPE_CHECKING:
    from cfid.records.parameters import Source
    from cfid.records.run import Run
    from cfid.records.tables.crossings import CrossingRecord
    from cfid.records.tables.wrench import WrenchRecord
    from cfid.transfer.sines.alignment import RecordedSine
    from cfid.transfer.sines.reports import SinePlan

_INPUT = "What was measured"
_COLUMNS = ("l", "n", "amplitude", "motor", "loadcell", "crossings")
_KIND = "sine"
_MOST_SAMPLES = 2**32 - 1
_ARM_MM, _YAW_DEG = 46.0, -45.0  # of the thesis (C.2.5), where nobody states others

Words = Annotated[
    list[str] | None, typer.Argument(metavar="RUN ...", help="Runs of cfid log sine; default: all complete ones.")
]


@dataclass(frozen=True, kw_only=True)
class SineInputs:
    """Where sine runs are, and what of the load cell tells their thrust."""

    index: Annotated[
        Path | None,
        typer.Option(
            help="CSV file, a row a run: l,n,amplitude,motor,loadcell,crossings[,series]; paths relative to it.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    channel: Annotated[
        Literal["arm", "Tx", "Ty", "Fz"],
        typer.Option(help="Torque about the motor's own arm, about x or y, or the force.", rich_help_panel=_INPUT),
    ] = "arm"
    sign: Annotated[
        Literal["auto", "+", "-"],
        typer.Option(help="Of thrust in that channel; auto: thrust is positive.", rich_help_panel=_INPUT),
    ] = "auto"
    arm_mm: Annotated[
        float | None,
        typer.Option(
            help="From the load cell's z axis to the motor's; default: the run's, else rig.toml's.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    yaw_deg: YawDeg = None
    offset: Annotated[
        float, typer.Option(min=0, max=FULL_COMMAND, help="B of eq. 3.6, of files.", rich_help_panel=_INPUT)
    ] = 30000.0

    @property
    def given(self) -> RigFacts:
        """The facts that options state. Raises ConfigError for what cannot be."""
        arm_mm = None if self.arm_mm is None else positive(self.arm_mm, "--arm-mm")
        yaw_deg = None if self.yaw_deg is None else finite(self.yaw_deg, "--yaw-deg")
        return RigFacts(loadcell=LoadCellMount(arm_mm=arm_mm, yaw_deg=yaw_deg))


@dataclass(frozen=True, kw_only=True)
class SineSet:
    """Runs by the name of their series, in order, and what is to be said of their files."""

    series: "dict[str, list[RecordedSine]]"
    warnings: tuple[str, ...]
    sources: "tuple[Source, ...]"
    paths: tuple[Path, ...]

    @property
    def runs(self) -> "list[RecordedSine]":
        """All runs."""
        return [run for own in self.series.values() for run in own]


@dataclass
class _Reader:
    """Reads files, each once, and keeps what they said."""

    inputs: SineInputs
    reading: ReadingOptions
    scale: LoadCellOptions
    facts: RigFacts  # of rig.toml, for files; a run notes its own
    series: "dict[str, list[RecordedSine]]" = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    sources: "list[Source]" = field(default_factory=list)
    _cells: "dict[Path, WrenchRecord]" = field(default_factory=dict)
    _thrusts: dict[tuple[Path, int], Any] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)  # of the run that has crossings of a hash

    def add_row(self, row: IndexRow) -> None:
        """Take a run that a row of an index names."""
        from cfid.records.tables.crossings import read_crossings
        from cfid.transfer.sines.reports import SinePlan

        samples = row.whole("n", 1, _MOST_SAMPLES)
        crossings = read_crossings(row.file("crossings"), time_unit=self.reading.time_unit)
        plan = SinePlan(
            name=f"l = {row.fields['l']} ({crossings.path.name})",
            periods=row.whole("l", 0, samples // 2),
            samples=samples,
            amplitude=row.number("amplitude"),
            motor=row.whole("motor", 0, 4),
            middle=self.inputs.offset,
        )
        self._add(row.fields.get("series", ""), plan, crossings, row.file("loadcell"), self.facts)

    def add_run(self, run: "Run", plan: "SinePlan") -> None:
        """Take a run of `cfid log sine`."""
        from cfid.records.tables.crossings import CROSSINGS, read_run_crossings
        from cfid.records.tables.times import losses

        crossings = read_run_crossings(run)
        said = losses(run, run.header.devices[CROSSINGS], len(crossings.host_s))
        self.warnings += [f"{run.folder.name}: {note}" for note in said]
        self._add(str(run.header.asked.get("series", "")), plan, crossings, run.folder, run.header.rig)

    def result(self) -> SineSet:
        """Return all that was taken. Motors' forces on all four count as one motor's."""
        if any(run.plan.motor == 0 for own in self.series.values() for run in own):
            self.warnings.append("all motors ran: the thrust of one is taken to be a quarter.")
        return SineSet(
            series=self.series,
            warnings=_gathered(self.warnings),
            sources=tuple(dict.fromkeys(self.sources)),
            paths=tuple(dict.fromkeys(Path(source.path) for source in self.sources)),
        )

    def _add(self, series: str, plan: "SinePlan", crossings: "CrossingRecord", loadcell: Path, facts: RigFacts) -> None:
        from cfid.transfer.sines.alignment import RecordedSine
        from cfid.transfer.sines.reports import Reports

        if (known := self._names.get(crossings.source.sha256)) is not None:
            raise DataError(f"{plan.name}: its crossings are those of {known} too: name each run once.")
        self._names[crossings.source.sha256] = plan.name
        time_s, force_n = self._thrust(loadcell, plan.motor, facts)
        reports = Reports(crossings.host_s, crossings.command, crossings.sample, crossings.vehicle_us)
        recorded = RecordedSine(plan=plan, reports=reports, time_s=time_s, force_n=force_n)
        self.series.setdefault(series or f"motor{plan.motor}", []).append(recorded)
        self.warnings += crossings.notes
        self.sources.append(crossings.source)

    def _thrust(self, path: Path, motor: int, facts: RigFacts) -> tuple[Any, Any]:
        """Return times by the host's clock and thrust (n,), with its bias, of a load cell's file or run."""
        from cfid.transfer.sines.alignment import thrust_of

        if (path, motor) not in self._thrusts:
            cell, inputs = self._cells[path], self.inputs
            if cell.begin_s is None:
                raise ConfigError("--rate-hz: a load cell is tied to the vehicle's reports by its times: leave it out.")
            arm_mm, yaw_deg = self._mount(facts)
            thrust = thrust_of(
                inputs.channel, cell.force_n, cell.torque_nm, arm_m=MM * arm_mm, motor=motor, yaw_deg=yaw_deg
            )
            self._thrusts[path, motor] = cell.time_s + cell.begin_s, thrust / 4 if motor == 0 else thrust
        time_s, thrust = self._thrusts[path, motor]
        return time_s, thrust

    def _mount(self, facts: RigFacts) -> tuple[float, float]:
        """Return arm and yaw, with a note where the channel needs one that nobody stated."""
        mount = self.inputs.given.over(facts).loadcell
        if mount.arm_mm is None and self.inputs.channel != "Fz":
            self.warnings.append(assumed(f"an arm of {_ARM_MM:g} mm is", "--arm-mm"))
        if mount.yaw_deg is None and self.inputs.channel == "arm":
            self.warnings.append(assumed(f"a yaw of {_YAW_DEG:g} degrees on the load cell is", "--yaw-deg"))
        return mount.arm_mm or _ARM_MM, _YAW_DEG if mount.yaw_deg is None else mount.yaw_deg

    def read_cells(self, paths: Iterable[Path]) -> None:
        """Read load cells' files side by side: parsing them takes longer than all that follows."""
        from concurrent.futures import ThreadPoolExecutor

        from cfid.records.tables.wrench import read_wrench

        new = list(dict.fromkeys(path for path in paths if path not in self._cells))
        with ThreadPoolExecutor(max_workers=2) as pool:
            cells = list(pool.map(lambda path: read_wrench(path, self.scale.reading(self.reading)), new))
        self._cells |= dict(zip(new, cells, strict=True))
        for cell in cells:
            self.warnings += cell.notes
            self.sources.append(cell.source)


def _plan_of(run: "Run") -> "SinePlan":
    """Return the sine that a run was asked to play. Raises DataError when it is a run of something else."""
    from cfid.transfer.sines.reports import SinePlan

    asked = run.header.asked
    missing = [key for key in ("l", "n", "amplitude", "motor") if not isinstance(asked.get(key), int)]
    if missing:
        told = f"its run.toml does not say {', '.join(missing)} of a sine"
        raise DataError(f"{run.folder}: a run of {run.header.kind}, no sine: {told}.")
    if not 0 <= 2 * asked["l"] <= asked["n"] or asked["n"] < 1:
        raise DataError(f"{run.folder}: its run.toml says l = {asked['l']} and n = {asked['n']}, which is no sine.")
    return SinePlan(
        name=f"l = {asked['l']} ({run.folder.name})",
        periods=asked["l"],
        samples=asked["n"],
        amplitude=asked["amplitude"],
        motor=asked["motor"],
    )


def _gathered(notes: Sequence[str]) -> tuple[str, ...]:
    """Return notes, what is said of many files once."""
    by_text: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        name, colon, text = note.partition(": ")
        by_text.setdefault(text if colon else name, []).append(name if colon else "")
    return tuple(
        f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {text}" if names[0] else text
        for text, names in by_text.items()
    )


def read_sines(
    words: Sequence[str], inputs: SineInputs, reading: ReadingOptions, scale: LoadCellOptions, workplace: Workplace
) -> SineSet:
    """Read the runs of an index and RUN folders.

    Without either, all sines of the campaign. Raises ConfigError when there is nothing to read, DataError with the
    file's name.
    """
    from cfid.records.tables.times import run_at

    reader = _Reader(inputs, reading, scale, workplace.facts)
    if inputs.index is not None:
        rows, source, notes = read_index(inputs.index, columns=_COLUMNS, optional=("series",))
        reader.sources.append(source)
        reader.warnings += notes
        reader.read_cells(row.file("loadcell") for row in rows)
        for row in rows:
            reader.add_row(row)
    runs = []
    for word in _words(words, inputs, workplace):
        path = find_recording(word, workplace)
        run = run_at(path)
        if run is None:
            raise DataError(f"{path}: no run folder; files of sines need an index: say --index FILE (see --help).")
        runs.append((run, _plan_of(run)))
    reader.read_cells(run.folder for run, _ in runs)
    for run, plan in runs:
        reader.add_run(run, plan)
    return reader.result()


def _words(words: Sequence[str], inputs: SineInputs, workplace: Workplace) -> list[str]:
    """Return names of runs: those that are meant, else every complete sine, where there is no index either."""
    if not words and inputs.index is not None:
        return []
    if not words and workplace.campaign is None:
        raise ConfigError("no sine to read: give RUNs of `cfid log sine`, or --index FILE.")
    return chosen(words, workplace.campaign, suits=lambda run: run.header.kind.startswith(_KIND), wanted="sines")
