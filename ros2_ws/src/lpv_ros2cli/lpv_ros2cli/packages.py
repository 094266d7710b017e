"""Installed packages: the ament index, with a ROS 2 sourced or in this Python's environment."""

import os
import sys
from pathlib import Path

from lpv_ros2cli.errors import CliError


def prefixes() -> list[Path]:
    """Prefixes in which packages are looked for."""
    named = [Path(p) for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    return list(dict.fromkeys((*named, Path(sys.prefix))))


def resources(kind: str) -> dict[str, Path]:
    """Entries of the ament index."""
    found: dict[str, Path] = {}
    for prefix in prefixes():
        folder = prefix / 'share' / 'ament_index' / 'resource_index' / kind
        for entry in sorted(folder.glob('[!.]*')):
            found.setdefault(entry.name, prefix)
    return dict(sorted(found.items()))


def names() -> list[str]:
    """Names of the packages."""
    return list(resources('packages'))


def prefix_of(package: str) -> Path:
    """Prefix of a package."""
    for prefix in prefixes():
        entry = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / package
        if Path(package).name == package and entry.is_file():
            return prefix
    raise CliError(f'Package {package!r} not found')


def share_of(package: str) -> Path:
    """Share folder of a package."""
    return prefix_of(package) / 'share' / package


def executables(package: str) -> list[Path]:
    """Programs of a package."""
    folder = prefix_of(package) / 'lib' / package
    return sorted(path for path in folder.rglob('*') if path.is_file() and os.access(path, os.X_OK))


def executable(package: str, name: str) -> Path:
    """One program of a package."""
    found = [path for path in executables(package) if path.name == name]
    if not found:
        known = ', '.join(sorted({path.name for path in executables(package)})) or 'none'
        raise CliError(f'No executable found: package {package!r} has no {name!r}; it has: {known}')
    if len(found) > 1:
        raise CliError(f'Multiple executables found: {", ".join(map(str, found))}')
    return found[0]
