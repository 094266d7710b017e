"""Output folder of a recorder, and the files that accompany the recording."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import ConfigError
from lpv.core.uio.certificate.gains import gains_in

GAINS_NAME = 'gains.yaml'
"""Of the copy of the gains that a run was answered with."""
SCENARIO_NAME = 'scenario.yaml'
"""Of the copy of the scenario that a run followed."""


def free_path(path: str | Path) -> Path:
    """The path itself, or the first of ``path_1``, ``path_2``, ... that does not exist."""
    path, whole = Path(path), Path(os.path.abspath(path))
    if not whole.name:
        raise ConfigError('output', 'is the root of all folders', str(path))
    others = (whole.with_name(f'{path.resolve().name}_{number}') for number in count(1))
    return path if not os.path.lexists(path) else next(p for p in others if not os.path.lexists(p))


@contextlib.contextmanager
def replaced(out: Path) -> Iterator[Path]:
    """Where to write a folder, which takes the place of ``out`` once all has gone well."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(prefix='.', dir=out.parent)
    except OSError as error:
        raise ConfigError('bag', f'cannot be written: {error}', str(out)) from error
    with folder as name:
        new = Path(name) / out.name
        yield new
        try:
            if os.path.lexists(out):
                out.rename(new.with_name(f'{out.name}.old'))  # removed with the temporary folder
            new.rename(out)
        except OSError as error:
            raise ConfigError('bag', f'cannot be replaced: {error}', str(out)) from error


def read_run_file(path: str | Path, name: str) -> bytes:
    """Bytes of a valid gains or scenario file, by the name of its copy; for `copy_file`."""
    if name == SCENARIO_NAME:
        load_scenario(path)
    else:
        gains_in(path)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError('file', f'cannot be read ({error})', str(path)) from error


def copy_file(data: bytes, folder: Path, name: str) -> None:
    """Write a file that accompanies a recording into the folder of its bag."""
    try:
        (folder / name).write_bytes(data)
    except OSError as error:
        raise ConfigError(name, f'cannot be copied: {error}', str(folder)) from error


def copy_run_files(bag: Path, out: Path) -> list[str]:
    """Copy gains and scenario of a run, if its bag has them; what is wrong with them."""
    wrong = []
    for name in (GAINS_NAME, SCENARIO_NAME):
        try:
            if (bag / name).is_file():
                copy_file(read_run_file(bag / name, name), out, name)
        except ConfigError as error:
            wrong.append(f'{name} is left out: {error}')
    return wrong
