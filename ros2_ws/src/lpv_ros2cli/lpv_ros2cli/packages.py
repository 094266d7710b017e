"""Installed packages: the ament index, with a ROS 2 sourced or in this Python's environment."""

import os
import sys
from pathlib import Path

from lpv_ros2cli.command_line import CliError


def prefix_of(package: str) -> Path:
    """Prefix of a package."""
    named = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    for prefix in map(Path, (*named, sys.prefix)):
        entry = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / package
        if Path(package).name == package and entry.is_file():
            return prefix
    raise CliError(f"Package '{package}' not found")


def share_of(package: str) -> Path:
    """Share folder of a package."""
    return prefix_of(package) / 'share' / package


def executable(package: str, name: str) -> Path:
    """One program of a package."""
    folder = prefix_of(package) / 'lib' / package
    programs = {file.name: file for file in folder.rglob('*') if os.access(file, os.X_OK)}
    if name not in programs:
        known = ', '.join(sorted(programs)) or 'none'
        raise CliError(f"No executable found: package '{package}' has no '{name}', only: {known}")
    return programs[name]
