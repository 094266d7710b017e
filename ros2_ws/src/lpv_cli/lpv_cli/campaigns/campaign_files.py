"""Campaigns by the names that a user gives them."""

from pathlib import Path
from typing import Any

from lpv_campaign.execution.store import CampaignFolder
from lpv_campaign.plan.campaign import resolve
from lpv_core.support.config import read_yaml
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


def open_folder(path: str | Path) -> tuple[Any, ...]:
    """Campaign of a results folder."""
    folder = CampaignFolder(path)
    campaign = folder.load()
    if campaign is None:
        raise ConfigError('spec', 'holds no results of a campaign', str(path))
    return campaign, folder


def open_file(name: str, out: str | None = None) -> tuple[Any, ...]:
    """Campaign of a campaign file, with the gains that were used if it has begun already."""
    path = Path(name)
    if not path.is_file():
        path = bringup_file('campaigns', name)
    campaign = resolve(read_yaml(path), str(path), path.resolve().parent)
    folder = CampaignFolder(out or Path('out') / 'campaign' / path.stem)
    begun = folder.load()
    return (begun if begun is not None and begun.key == campaign.key else campaign), folder
