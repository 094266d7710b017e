"""YAML of the command line and of files, through the safe loader, with one-line errors."""

from pathlib import Path

import yaml

from lpv_ros2cli.errors import CliError

MAX_BYTES = 4 << 20
"""Longest text and largest file that is read [bytes]."""


def parse_yaml(text: str, what: str) -> object:
    """Value of a YAML text."""
    if len(text) > MAX_BYTES:
        raise CliError(f'{what} is longer than {MAX_BYTES} bytes')
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CliError(f'{what} is not valid YAML: {" ".join(str(error).split())}') from error


def read_yaml(path: str | Path, what: str) -> object:
    """Value of a YAML file."""
    return parse_yaml(read_text(path, what), f'{what} {path}')


def read_text(path: str | Path, what: str) -> str:
    """Text of a file."""
    try:
        with open(path, 'rb') as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise CliError(f'{what} {path} is larger than {MAX_BYTES} bytes')
        return data.decode('utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise CliError(f'{what} {path} cannot be read: {error}') from error
