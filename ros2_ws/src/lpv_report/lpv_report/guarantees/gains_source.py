"""Which gains a run was made with."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from lpv_bag.errors import BagError
from lpv_bag.rosbag.output_folder import GAINS_NAME
from lpv_core.certificate.gains import Gains, load_gains
from lpv_core.model.arm import ArmParameters, arm_from_json
from lpv_core.support.errors import ConfigError


@dataclass(frozen=True)
class UsedGains:
    """Gains of a run, or why they are not known."""

    gains: Gains | None = None  # none where they are not known
    source: str = ''  # where they come from, for the reader
    digest: str = ''  # SHA-256 of their file
    problem: str = ''  # why they are not known; empty where they are


UNKNOWN = UsedGains(problem='The bag carries no gains, and none were given.')


def read_used_gains(path: str | Path, source: str = '') -> UsedGains:
    """Gains from a file.

    Parameters
    ----------
    path : str or pathlib.Path
        Gains file.
    source : str, optional
        Where they come from; the name of the file if not given.

    Returns
    -------
    UsedGains
        With gains.

    Raises
    ------
    ConfigError
        If it is no gains file.
    """
    path = Path(path)
    gains = load_gains(path)
    return UsedGains(gains, source or path.name, hashlib.sha256(path.read_bytes()).hexdigest())


def find_used_gains(bag: str | Path, given: str | Path | None = None) -> UsedGains:
    """Gains of a recorded run: those given, or those in the bag.

    Parameters
    ----------
    bag : str or pathlib.Path
        rosbag2 directory or single storage file.
    given : str or pathlib.Path, optional
        Gains file named by the user.

    Returns
    -------
    UsedGains
        Without gains where the bag has none, or where they cannot be read.

    Raises
    ------
    ConfigError
        If the given file is no gains file.
    BagError
        If there is no such bag.
    """
    if not Path(bag).exists():
        raise BagError(f'{bag}: there is no such bag')
    if given:
        return read_used_gains(given)
    folder = Path(bag) if Path(bag).is_dir() else Path(bag).parent
    # A single file belongs to the folder's bag only if that is one.
    if not (folder / GAINS_NAME).is_file() or not (
        folder == Path(bag) or (folder / 'metadata.yaml').is_file()
    ):
        return UNKNOWN
    try:
        return read_used_gains(folder / GAINS_NAME, f'{GAINS_NAME} of the bag')
    except (ConfigError, OSError) as error:
        return UsedGains(problem=f'The gains in the bag cannot be used: {error}')


def arm_of(gains: Gains) -> ArmParameters:
    """The arm that a gains file describes.

    Parameters
    ----------
    gains : Gains
        The gains.

    Returns
    -------
    ArmParameters
        The arm they were designed for.

    Raises
    ------
    ConfigError
        If there is no description, or it is that of another arm than the hash.
    """
    text = gains.certificate.get('arm_json')
    if not isinstance(text, str):
        raise ConfigError('gains.certificate.arm_json', 'is missing: give the arm with --arm')
    arm = arm_from_json(text)
    gains.check_arm(arm)
    return arm
