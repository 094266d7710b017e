"""Arm and gains of a run, and what the certificate of these gains proves of this arm."""

import contextlib
import hashlib
from dataclasses import dataclass
from pathlib import Path

from lpv.bag.rosbag.output_folder import GAINS_NAME
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.certificate.certified import CertifiedGains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.two_links import arm_from_json, two_link_arm
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.inequalities import Check
from lpv.core.support.resources import bringup_file, shipped_files
from lpv.core.uio.certificate.gains import load_certified

_ANSWERS = [f'lpv_msgs/msg/{kind}' for kind in ('FaultEstimate', 'StateEstimate', 'FaultAlarm')]


@dataclass(frozen=True)
class Certificate:
    """What gains prove, as far as it could be verified without any solver."""

    what: str = 'gains'  # what is certified: the gains, or the tracking loop
    facts: tuple[tuple[str, str], ...] = ()  # name and value
    checks: tuple[Check, ...] = ()  # all inequalities, rebuilt now
    problem: str = ''  # why nothing could be rebuilt; empty otherwise

    @property
    def failed(self) -> list[str]:
        """Names of the inequalities that do not hold."""
        return [check.name for check in self.checks if not check.holds]

    @property
    def holds(self) -> bool:
        """Whether all inequalities hold now."""
        return bool(self.checks) and not self.failed

    @property
    def bounds_faults(self) -> bool:
        """Whether bounds of fault estimates rest on it."""
        return self.holds and self.what == 'gains'


def described_arm(gains: CertifiedGains) -> SerialArm | None:
    """The arm that gains describe or that is shipped under their name, if it is theirs."""
    text = getattr(gains, 'certificate', {}).get('arm_json')
    if isinstance(text, str):
        return two_link_arm(arm_from_json(text))
    file = shipped_files('arms').get(gains.arm_name)
    return load_arm(file) if file is not None else None


def examine(path: str | Path | None, arm: SerialArm, source: str = '') -> Certificate:
    """Verify the certificate of a gains file for an arm; what stands against it is its problem."""
    if path is None:
        return Certificate(problem='the bag carries no gains, and none were given')
    try:
        found = load_certified(path)
        facts = [
            ('gains file', source or Path(path).name),
            ('SHA-256 of the file', hashlib.sha256(Path(path).read_bytes()).hexdigest()),
            ('designed for arm', found.arm_name),
        ]
        checks = found.verify(arm)
        facts += [('certified', line.strip()) for line in found.facts(arm)]
        return Certificate(found.what, tuple(facts), tuple(checks))
    except (LpvError, OSError) as error:
        return Certificate(problem=str(error))


def beside_bag(bag: str | Path, name: str) -> Path | None:
    """A file that accompanies a bag; None where there is none."""
    folder = Path(bag) if Path(bag).is_dir() else Path(bag).parent
    # A single file belongs to the folder's bag only if that is one.
    ours = folder == Path(bag) or (folder / 'metadata.yaml').is_file()
    return folder / name if ours and (folder / name).is_file() else None


def find_arm_and_gains(
    bag: str | Path, arm: SerialArm | None, gains: str | Path | None = None
) -> tuple[SerialArm, Path | None, str]:
    """Arm and gains as given, else of the bag, else shipped; where the gains come from."""
    file = bringup_file('gains', str(gains)) if gains else beside_bag(bag, GAINS_NAME)
    source = file.name + ('' if gains else ' of the bag') if file else ''
    if arm:
        return arm, file, source
    # A damaged file in a bag must not stand in the way of a report.
    with contextlib.nullcontext() if gains else contextlib.suppress(ConfigError):
        if file and (described := described_arm(load_certified(file))):
            return described, file, source
    name = named_arm(bag)
    shipped = shipped_arm(name)
    if file is None and (file := shipped_files('gains').get(name)):
        source = f'shipped gains of arm {name!r}, which the messages name'
    return shipped, file, source


def shipped_arm(name: str) -> SerialArm:
    """The arm that a bag names; ConfigError if it names none, '', or one that is not shipped."""
    if name in (files := shipped_files('arms')):
        return load_arm(files[name])
    what = 'neither gains nor answers of the diagnosis in the bag name one'
    if name:
        what = f'the bag is of arm {name!r}, which is not a shipped one'
    raise ConfigError('--arm', f'is needed: {what}; e.g. --arm {name or "my_arm"}.yaml')


def named_arm(bag: str | Path) -> str:
    """Name of the arm that recorded answers of the diagnosis carry; '' without answers."""
    # Only here: gains are examined where there is no bag, too.
    from lpv.bag.rosbag.reading import open_bag

    with open_bag(bag) as reader:
        answers = [c for c in reader.connections if c.msgtype in _ANSWERS and c.msgcount]
        for connection, _, data in reader.messages(answers) if answers else ():
            return str(reader.deserialize(data, connection.msgtype).header.frame_id)
    return ''
