"""Keep fits that a test composes by hand, and read a campaign's values back."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cfid.experiments import EXPERIMENTS
from cfid.records.campaign import find_campaign
from cfid.records.files import RIG_FILE
from cfid.records.fits import Fit, keep_fit, list_fits, path_of
from cfid.records.parameters import Section
from cfid.records.rig_file import Rig, thesis_rig
from cfid.records.values import Values


def keep(folder: Path, name: str, section: Section, **more: Any) -> Fit:
    """Keep a section as a campaign's next fit; `more` replaces what a fit states besides."""
    kind = EXPERIMENTS.get(name.partition(" ")[0])
    usual: dict[str, Any] = {"command": f"fit {name}", "quality": {}, "revision": 1 if kind is None else kind.revision}
    return keep_fit(folder / "fits", Fit(name=name, section=section, **(usual | more)))


def keep_instead(folder: Path, name: str, section: Section) -> Fit:
    """Keep a section as the only fit of its name."""
    for fit in list_fits(folder / "fits"):
        if isinstance(fit, Fit) and fit.name == name:
            path_of(folder / "fits", fit).unlink()
    return keep(folder, name, section)


def values_at(folder: Path) -> Values:
    """Return the values of a campaign, or those of the fits in a folder without a rig."""
    if (folder / RIG_FILE).exists():
        campaign = find_campaign(folder)
        assert campaign is not None
        return campaign.values()
    return Values((fit for fit in list_fits(folder / "fits") if isinstance(fit, Fit)), thesis_rig(), lambda _: ())


def sections_at(folder: Path) -> dict[str, Section]:
    """Return a campaign's values by the fit that they come from."""
    return values_at(folder).sections()


def values_of(sections: Mapping[str, Section], rig: Rig | None = None) -> Values:
    """Return the values of fits of these sections, of which a later one in the mapping was made later."""
    fits = [
        Fit(name=name, command=f"fit {name}", section=section, quality={}, number=number, stem=f"{number:04d}_{name}")
        for number, (name, section) in enumerate(sections.items(), start=1)
    ]
    return Values(fits, rig or thesis_rig(), lambda _: ())
