"""Remember that a fit of a whole campaign gave no result, so that it is not suggested again until something changes."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from cfid.console.flat import given_options, given_words
from cfid.errors import CfidError, DataError, FitError, RejectedError
from cfid.guide.plan import tasks
from cfid.records.campaign import find_campaign


@contextmanager
def remembered(path: str, command: Callable[..., None], options: Mapping[str, Any]) -> Iterator[None]:
    """Keep why a command gave no result, if it is a fit as `cfid status` names it: of all runs, with its defaults.

    A failure to keep the reason is ignored, since the command has already ended with its own error.
    """
    try:
        yield
    except (DataError, FitError) as error:
        if not isinstance(error, RejectedError) and not (
            given_words(command, options) or given_options(command, options)
        ):
            with suppress(CfidError, OSError):
                campaign = find_campaign(options.get("campaign"))
                for task in () if campaign is None else tasks(campaign.rig, kind="full"):
                    if campaign is not None and " ".join(task.fit) == path:
                        campaign.keep_refused(task.section, path, str(error))
        raise
