"""Remember that a fit of a whole campaign gave no result, so that it is not suggested again until something changes."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from cfid.errors import CfidError
from cfid.guide.plan import tasks
from cfid.records.campaign import find_campaign

_OUTPUT = ("--no-figures", "--json", "--quiet")  # these do not affect results


def remember_refusal(words: Sequence[str], error: CfidError) -> None:
    """Store why a command gave no result, if it is a fit as `cfid status` names it: of all runs, with its defaults.

    A failure to store the reason is ignored, since the command has already ended with its own error.
    """
    with suppress(CfidError, OSError):
        rest, folder = _without_campaign([word for word in words if word not in _OUTPUT])
        campaign = find_campaign(folder)
        if campaign is None:
            return
        for task in tasks(campaign.rig, kind="full"):
            if tuple(rest) == task.fit:
                campaign.remember_refused(task.section, str(error))


def _without_campaign(words: Sequence[str]) -> tuple[list[str], Path | None]:
    """Return a command's words without the option --campaign, and the folder that it names."""
    if "--campaign" not in words[:-1]:
        return list(words), None
    place = list(words).index("--campaign")
    return [*words[:place], *words[place + 2 :]], Path(words[place + 1])
