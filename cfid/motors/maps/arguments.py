"""From the arguments of `cfid fit thrust`, `speed` and `torque` to files, runs and tables of motors."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cfid.console.inputs import Workplace, find_recording, split_label
from cfid.console.selection import chosen
from cfid.errors import ConfigError, DataError, FitError
from cfid.findings import explained, warning
from cfid.motors.maps.data import of_file, of_run
from cfid.motors.maps.evidence import Evidence, Stand, together
from cfid.motors.maps.table_data import of_table
from cfid.motors.vibration.data import Rotors
from cfid.recordings.read import kind_at
from cfid.recordings.recording import How
from cfid.recordings.stand import STAND, holds_stand, read_stand, stand_of
from cfid.records.choose import Matches, labelled
from cfid.records.run import Run, refuse_contradiction, run_at, run_holding
from cfid.units import FULL_COMMAND

_NOTHING = ConfigError(
    "nothing to fit: give a thrust stand's CSV file, COMMAND=FILE ..., or a RUN of `cfid log thrust` or speed."
)


def read_evidence(
    words: Sequence[str],
    workplace: Workplace,
    *,
    known: Stand,
    table: Path | None,
    kind: str,
    method: str,
    rotors: Rotors | None = None,
) -> Evidence:
    """Read COMMAND=FILE arguments, runs and tables, and put all their points together.

    Without any of them, the campaign's complete runs of a `kind` are taken. With `rotors`, missing speeds are estimated
    from vibration. A run that gives nothing is left out with a warning where others give something.

    Raises ConfigError when there is nothing to read, DataError and FitError that name the file.
    """
    faults: list[DataError | FitError] = []

    def of_stand(path: Path) -> Evidence:
        if known.window_s is not None or known.flip_fz is not None:
            raise ConfigError(
                f"`window` and `flip_fz` are for a load cell's recording, and {path} is a thrust stand's table."
            )
        how = How(motors=known.motors)
        read = stand_of(read_stand(path, how), how, gravity_mps2=workplace.rig.site.gravity_mps2)
        return of_table(read, known, workplace.facts)

    def of_runs(run: Run) -> list[Evidence]:
        try:
            return [of_run(run, known, rotors=rotors)]
        except (DataError, FitError) as error:  # one part of a resumed staircase does not condemn the others
            faults.append(error)
            return []

    parts = [] if table is None else [of_stand(table)]
    for word in _meant(words, parts, workplace, kind):
        command, file = split_label(word, workplace)
        if command:
            at = _command(command, word)
            if (run := run_holding(Path(file))) is not None:
                refuse_contradiction(word, {"command": at}, {"command": run.header.requested.get("steps")})
            here = known.where(workplace.facts)
            parts.append(of_file(at, Path(file), here, method=method, rotors=rotors))
        else:
            path = find_recording(word, workplace, _of_kinds(kind, STAND))
            if holds_stand(path):
                parts.append(of_stand(path))
            elif (run := run_at(path)) is not None:
                parts += of_runs(run)
            elif kind_at(path) == "wrench":
                raise DataError(f"{path}: a load cell's file needs its command: write COMMAND={path}.")
            else:
                parts.append(of_stand(path))
    if not parts:
        raise next(iter(faults), _NOTHING)
    if not any(len(part.points.command) for part in parts):
        raise explained(FitError("no step settles."), [part.findings[-1] for part in parts if part.findings])
    left_out = tuple(warning("run-left-out", f"{error} It is left out.") for error in faults)
    found = together(parts)
    return replace(found, findings=(*left_out, *found.findings))


def _meant(words: Sequence[str], tables: Sequence[Evidence], workplace: Workplace, kind: str) -> Sequence[str]:
    if workplace.campaign is None or (tables and not words):
        return words
    suits = _of_kinds(kind, STAND) if words else labelled(kind)  # a stand is taken where it is named
    return chosen(words, workplace.campaign, suits=suits, wanted=f"runs of cfid log {kind}")


def _of_kinds(*kinds: str) -> Matches:
    return lambda run: run.header.kind in kinds


def _command(text: str, word: str) -> int:
    if not text.isdecimal() or int(text) > FULL_COMMAND:
        raise ConfigError(f"'{word}': '{text}' is no command from 0 to {FULL_COMMAND}: write COMMAND=FILE.")
    return int(text)
