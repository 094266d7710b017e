"""Files of a search: the worst attack as YAML, and its measurements as a bag that replays."""

from pathlib import Path
from typing import Any

import yaml

from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_campaign.falsify.search import Attacker, Finding
from lpv_core.support.config import read_yaml
from lpv_core.support.errors import ConfigError

SCENARIO, BAG = 'worst.yaml', 'worst_bag'
LONGEST = 3600.0
"""Longest run [s]."""
_START = 10**9
"""Stamp of the first message [ns]."""


def write_worst(attacker: Attacker, worst: Finding, folder: str | Path) -> None:
    """Write the worst attack and the bag of its run into a folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        'ratio': worst.ratio,
        'sensor': attacker.arm.sensor_names[worst.sensor],
        'time': worst.time,
        'threshold': worst.threshold,
        'duration': len(attacker.readings()) * attacker.arm.sample_time,
        'attack': attacker.as_dict(worst.attack),
    }
    (folder / SCENARIO).write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    attacker.run(worst.attack)
    arm = attacker.arm
    with BagWriter(folder / BAG, 'zstd_small') as writer:
        messages = BagMessages(writer.typestore, 'base_link')
        writer.add_topic('/lpv/joint_states', 'sensor_msgs/msg/JointState')
        for k, sample in enumerate(attacker.readings()):
            stamp = _START + k * round(arm.sample_time * 1e9)
            message = messages.joint_state(stamp, arm.joint_names, *sample.tolist())
            writer.write('/lpv/joint_states', stamp, message)


def read_attack(path: str | Path) -> tuple[dict[str, Any], float]:
    """Attack, for `Attacker.from_dict`, and duration [s] of a file that `write_worst` wrote.

    Raises
    ------
    ConfigError
        If it is no such file.
    """
    data = read_yaml(path)
    try:
        duration = float(data['duration'])
        if not isinstance(data['attack'], dict) or not 0.0 < duration <= LONGEST:
            raise ValueError(f'no attack of at most {LONGEST:g} s')
        return data['attack'], duration
    except (KeyError, TypeError, ValueError) as error:
        raise _no_attack(error, path) from None


def repeat(attacker: Attacker, data: dict[str, Any], path: str | Path) -> Finding:
    """Run the attack of a file again; errors as of `read_attack`."""
    try:
        attack = attacker.from_dict(data)
    except (KeyError, TypeError, ValueError) as error:
        raise _no_attack(error, path) from None
    return attacker.run(attack)


def _no_attack(error: Exception, path: str | Path) -> ConfigError:
    return ConfigError('attack', f'is not that of lpv falsify ({error})', str(path))
