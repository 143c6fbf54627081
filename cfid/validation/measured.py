"""Read a vehicle's measured parameters, from a campaign or a kept fit, and the logs they come from."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from cfid.errors import CfidError
from cfid.flight.channels import same_flight
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Recording
from cfid.records.campaign import Campaign
from cfid.records.files import RIG_FILE
from cfid.records.fits import read_fit
from cfid.records.parameters import Parameter
from cfid.records.rig_file import Rig, load_rig, thesis_rig
from cfid.records.run import run_holding
from cfid.records.values import Values


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The values of a campaign or of one kept fit, with the rig, None for a fit outside a campaign.

    Paths of their recordings are relative to `folder`.
    """

    name: str
    folder: Path
    values: Values
    rig: Rig | None

    def get(self, key: str) -> Parameter | None:
        """Return an accepted parameter, None where there is none."""
        value = self.values.find(key)
        return None if value is None or not value.accepted or value.parameter.value is None else value.parameter

    def __getitem__(self, key: str) -> Parameter:
        """Return an accepted parameter. Raises KeyError with a sentence where there is none."""
        found = self.get(key)
        if found is not None:
            return found
        reason = self.values.rejected(key)
        raise KeyError(f"{key} was rejected: {reason}" if reason else f"{key} is not there.")

    def fitted_to(self, log: Recording) -> bool:
        """Return whether any parameter comes from a log: from this file, or from the same flight in another file."""
        hashes = {source.sha256 for fit in self.values.by_fit for source in fit.section.sources}
        return log.source.sha256 in hashes or any(same_flight(log, one) for one in self._flights())

    def _flights(self) -> Iterator[Recording]:
        """Yield the logs of flights whose files still exist at their paths."""
        for source in (source for fit in self.values.by_fit if fit.name == "flight" for source in fit.section.sources):
            path = self.folder / source.path
            with suppress(CfidError):
                run = run_holding(path)
                yield read_recording(path if run is None else run.folder)


def measured_in(campaign: Campaign) -> Measured:
    """Return the values of a campaign."""
    folder = campaign.folder
    return Measured(name=folder.resolve().name, folder=folder, values=campaign.values(), rig=campaign.rig)


def measured_file(path: Path) -> Measured:
    """Return the values of a kept fit by its path. Raises DataError for another file."""
    fit, folder = read_fit(path), path.absolute().parent.parent
    rig = load_rig(folder / RIG_FILE) if (folder / RIG_FILE).is_file() else None
    return Measured(name=fit.stem, folder=folder, values=Values([fit], rig or thesis_rig(), lambda _: ()), rig=rig)
