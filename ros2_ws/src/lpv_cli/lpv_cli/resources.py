"""Where packages keep their files and programs, with a ROS 2 sourced or without."""

import os
import sys
from pathlib import Path

from lpv_core.errors import ConfigError


def _prefix(package):
    # The ament index by hand: its Python package refuses to look where nothing is sourced, and
    # programs built into a virtual environment must run without.
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    for prefix in (*prefixes, sys.prefix):
        if (Path(prefix) / 'share' / 'ament_index' / 'resource_index' / 'packages'
                / package).is_file():
            return Path(prefix)
    raise ConfigError(package, 'is not installed: build the workspace, or source it')


def executable(package, name):
    """Program that ``ros2 run PACKAGE NAME`` starts.

    Parameters
    ----------
    package, name : str
        ROS package and program.

    Returns
    -------
    pathlib.Path
        Its file.

    Raises
    ------
    ConfigError
        If it is not installed.
    """
    path = _prefix(package) / 'lib' / package / name
    if not path.is_file():
        raise ConfigError(f'{package}/{name}', f'there is no program {path}')
    return path


def bringup_file(kind, name):
    """An arm or scenario file: a path, or the bare name of a shipped one.

    Parameters
    ----------
    kind : {'arms', 'scenarios'}
        Folder of lpv_bringup.
    name : str
        Bare name (``paper``) or path.

    Returns
    -------
    pathlib.Path
        Existing file.

    Raises
    ------
    ConfigError
        If there is none; names the shipped ones.
    """
    path = Path(name)
    if path.suffix in ('.yaml', '.yml'):
        if not path.is_file():
            raise ConfigError(kind[:-1], f'there is no file {name}')
        return path.resolve()
    folder = _prefix('lpv_bringup') / 'share' / 'lpv_bringup' / kind
    path = folder / f'{name}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(p.stem for p in folder.glob('*.yaml')))
        raise ConfigError(kind[:-1], f'{name!r} is neither a file nor shipped; shipped: {known}')
    return path
