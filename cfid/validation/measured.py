"""Read a vehicle's measured parameters, from a campaign or a single file, and the logs they come from."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from cfid.errors import CfidError, DataError
from cfid.flight.channels import same_flight
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Recording
from cfid.records.campaign import Campaign
from cfid.records.files import RIG_FILE
from cfid.records.parameters import Parameter, Section, load_sections
from cfid.records.rig_file import Rig, load_rig
from cfid.records.run import run_holding
from cfid.records.values import find_parameter

_OF_CAMPAIGNS = "parameters.toml"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Sections of parameters by fit, with the rig that they were measured on, None without a rig.toml next to them.

    Paths of their recordings are relative to `folder`.
    """

    name: str
    folder: Path
    sections: Mapping[str, Section]
    rig: Rig | None

    def get(self, key: str) -> Parameter | None:
        """Return an accepted parameter, None where there is none."""
        found = find_parameter(self.sections, key)
        return None if found is None or found.rejected else found.parameter

    def __getitem__(self, key: str) -> Parameter:
        """Return an accepted parameter. Raises KeyError with a sentence where there is none."""
        found = self.get(key)
        if found is not None:
            return found
        reasons = (one.rejected[key] for one in self.sections.values() if key in one.rejected)
        raise KeyError(f"{key} was rejected: {reason}" if (reason := next(reasons, "")) else f"{key} is not there.")

    def fitted_to(self, log: Recording) -> bool:
        """Return whether any parameter comes from a log: from this file, or from the same flight in another file."""
        hashes = {source.sha256 for one in self.sections.values() for source in one.sources}
        return log.source.sha256 in hashes or any(same_flight(log, one) for one in self._flights())

    def _flights(self) -> Iterator[Recording]:
        """Yield the logs of flights whose files still exist at their paths."""
        for source in (source for name, one in self.sections.items() if name == "flight" for source in one.sources):
            path = self.folder / source.path
            with suppress(CfidError):
                run = run_holding(path)
                yield read_recording(path if run is None else run.folder)


def measured_in(campaign: Campaign) -> Measured:
    """Return the parameters of a campaign. Raises DataError when parameters.toml is invalid."""
    folder = campaign.folder
    return Measured(name=folder.resolve().name, folder=folder, sections=campaign.sections(), rig=campaign.rig)


def measured_file(path: Path) -> Measured:
    """Return the parameters in a file by its path, with the rig.toml next to it. Raises DataError for another file."""
    sections = load_sections(path)
    if not sections:
        raise DataError(f"{path}: holds no parameters. Give a campaign's folder, or a file as its parameters.toml.")
    folder, beside = path.parent, path.parent / RIG_FILE
    name = folder.resolve().name if path.name == _OF_CAMPAIGNS else path.name
    return Measured(name=name, folder=folder, sections=sections, rig=load_rig(beside) if beside.is_file() else None)
