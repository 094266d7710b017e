"""Where packages keep their files and programs, with a ROS 2 sourced or without."""

import os
import site
import sys
from pathlib import Path

from lpv.core.support.errors import ConfigError

SOURCES = Path(__file__).resolve().parents[4]
"""Where the packages are in a checkout."""


def prefixes() -> list[Path]:
    """Where packages may be: what is sourced of ROS 2, then this Python's environment."""
    sourced = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    return [*map(Path, sourced), Path(sys.prefix), Path(site.getuserbase())]


def prefix_of(package: str) -> Path:
    """Where a package is installed, with a ROS 2 sourced or in this Python's environment."""
    # The ament index by hand: its Python package refuses to look where nothing is sourced, and
    # programs built into a virtual environment must run without.
    for prefix in prefixes():
        index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
        if Path(package).name == package and (index / package).is_file():
            return prefix
    reason = 'is not installed: build the workspace, or source it'
    raise ConfigError(f'package {package!r}', reason)


def installed_version(distribution: str, otherwise: str = '') -> str:
    """Version of an installed Python distribution."""
    from importlib.metadata import PackageNotFoundError, version  # only here: it takes time

    try:
        return version(distribution)
    except PackageNotFoundError:
        return otherwise


def executable(package: str, name: str) -> Path:
    """Program that ``ros2 run PACKAGE NAME`` starts."""
    folder = prefix_of(package) / 'lib' / package
    programs = {file.name: file for file in folder.rglob('*') if os.access(file, os.X_OK)}
    if name not in programs:
        known = ', '.join(sorted(programs)) or 'none'
        raise ConfigError(f'package {package!r}', f'has no program {name!r}, only: {known}')
    return programs[name]


def shipped_files(kind: str) -> dict[str, Path]:
    """Files of one kind that are installed with lpv_bringup, or of the checkout that runs."""
    folder = SOURCES / 'lpv_bringup' / kind
    if not folder.is_dir():
        folder = prefix_of('lpv_bringup') / 'share' / 'lpv_bringup' / kind
    return {file.stem: file for file in sorted(folder.glob('*.yaml'))}


def bringup_file(kind: str, name: str, folder: str | Path = '.') -> Path:
    """An arm, scenario, column or campaign file: a path, or the bare name of a shipped one.

    ``kind`` is a folder of lpv_bringup, e.g. arms; paths count from ``folder`` on.  A bare name
    goes with or without ``.yaml``.  ConfigError, which names the shipped files, if there is no such
    file.
    """
    path = Path(folder, name)
    if path.suffix in ('.yaml', '.yml') and path.is_file():
        return path.resolve()
    # A bare name cannot leave the folder.
    shipped = shipped_files(kind)
    if path.name == name and path.suffix in ('', '.yaml') and path.stem in shipped:
        return shipped[path.stem]
    if path.is_file():
        return path.resolve()
    raise ConfigError(
        kind.rstrip('s'), f'{name!r} is neither a file nor shipped; shipped: ' + ', '.join(shipped)
    )
