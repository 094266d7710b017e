"""Which gains a run was made with."""

import hashlib
import logging
from dataclasses import dataclass
from pathlib import Path

from lpv_bag.errors import BagError
from lpv_bag.rosbag.output_folder import GAINS_NAME, SCENARIO_NAME
from lpv_bag.rosbag.reading import open_bag
from lpv_core.certificate.gains import Gains, load_gains
from lpv_core.model.arm import ArmParameters, arm_from_json
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import shipped_files


@dataclass(frozen=True)
class UsedGains:
    """Gains of a run, or why they are not known."""

    gains: Gains | None = None  # none where they are not known
    source: str = ''  # where they come from, for the reader
    digest: str = ''  # SHA-256 of their file
    problem: str = ''  # why they are not known; empty where they are


_LOG = logging.getLogger(__name__)
_ANSWERS = tuple(
    f'lpv_msgs/msg/{name}' for name in ('FaultEstimate', 'StateEstimate', 'FaultAlarm')
)
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
    file = beside_bag(bag, GAINS_NAME)
    if file is None:
        return UNKNOWN
    try:
        return read_used_gains(file, f'{GAINS_NAME} of the bag')
    except (ConfigError, OSError) as error:
        return UsedGains(problem=f'The gains in the bag cannot be used: {error}')


def beside_bag(bag: str | Path, name: str) -> Path | None:
    """A file that accompanies a bag; None where there is none."""
    folder = Path(bag) if Path(bag).is_dir() else Path(bag).parent
    # A single file belongs to the folder's bag only if that is one.
    ours = folder == Path(bag) or (folder / 'metadata.yaml').is_file()
    return folder / name if ours and (folder / name).is_file() else None


def find_scenario(bag: str | Path) -> Scenario | None:
    """Scenario that lies in a bag; None where there is none of a planar path that can be drawn.

    Parameters
    ----------
    bag : str or pathlib.Path
        rosbag2 directory or single storage file.

    Returns
    -------
    Scenario or None
        For its path and obstacle: a damaged copy must not stand in the way of a report.
    """
    file = beside_bag(bag, SCENARIO_NAME)
    try:
        found = None if file is None else load_any_scenario(file)
        return found if isinstance(found, Scenario) else None
    except ConfigError as error:
        _LOG.warning('%s', error)
        return None


def named_arm(bag: str | Path) -> str:
    """Name of the arm that recorded answers of the diagnosis carry; '' without answers.

    Parameters
    ----------
    bag : str or pathlib.Path
        rosbag2 directory or single storage file.

    Returns
    -------
    str
        ``frame_id`` of their headers.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    with open_bag(bag) as reader:
        answers = [c for c in reader.connections if c.msgtype in _ANSWERS and c.msgcount]
        for connection, _, data in reader.messages(answers) if answers else ():
            return str(reader.deserialize(data, connection.msgtype).header.frame_id)
    return ''


def find_shipped_gains(bag: str | Path) -> UsedGains:
    """Shipped gains of the arm that the messages of a bag name.

    A bag of ``ros2 bag record`` has no gains beside it.  Whether the run had these gains is not
    known from the name: the report runs the diagnosis again, and says whether it gives the
    recorded estimates.

    Parameters
    ----------
    bag : str or pathlib.Path
        rosbag2 directory or single storage file.

    Returns
    -------
    UsedGains
        Without gains where no message names a shipped arm; its problem says what to give.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    name = named_arm(bag)
    if not name:
        return UsedGains(
            problem='the bag holds neither gains nor answers of the diagnosis; say which arm it '
            'is of, e.g. lpv report BAG --arm my_arm.yaml'
        )
    shipped = shipped_files('gains')
    if name not in shipped:
        return UsedGains(
            problem=f'the bag is of arm {name!r}, which is not a shipped one; give its files, '
            f'e.g. lpv report BAG --arm {name}.yaml --gains gains.yaml'
        )
    source = f'shipped gains of arm {name!r}, which the messages name'
    try:
        return read_used_gains(shipped[name], source)
    except ConfigError as error:
        return UsedGains(problem=f'the {source}, cannot be used: {error}')


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
