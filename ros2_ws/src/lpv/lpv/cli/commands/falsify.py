"""``lpv falsify``: search for a healthy run that crosses its threshold."""

import argparse
import sys
from pathlib import Path

from lpv.campaign.falsify.attack import Attacker, Finding
from lpv.campaign.falsify.search import BAG, SCENARIO, read_attack, repeat, search, write_worst
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import load_gains


def run(arguments: argparse.Namespace) -> int:
    """Search, write the worst run so far; 1 if a healthy arm crossed a threshold."""
    arm = arguments.arm
    if arguments.repeat:
        attack, duration = read_attack(arguments.repeat)
        attacker = _attacker(arm, arguments.gains, duration)
        return _conclude(attacker, [repeat(attacker, attack, arguments.repeat)])
    attacker, folder = _attacker(arm, arguments.gains, arguments.duration), Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)  # what fails is said before hours of searching
    if (folder / BAG).exists():
        raise ConfigError('--out', f'{folder} holds the worst run of another search')
    found = list[Finding]()
    try:
        search(attacker, arguments.evaluations, arguments.seed, _show, found)
    except KeyboardInterrupt:
        if found:
            _write(attacker, found, folder)
        raise  # to the exit code of all commands that are interrupted
    return _write(attacker, found, folder)


def _write(attacker: Attacker, found: list[Finding], folder: Path) -> int:
    found.sort(key=lambda finding: -finding.ratio)
    write_worst(attacker, found[0], folder)
    print(f'worst run: {folder / SCENARIO}, {folder / BAG}')
    return _conclude(attacker, found)


def _attacker(arm: SerialArm, gains_file: str | None, duration: float) -> Attacker:
    if not gains_file:
        return Attacker(arm, duration)
    gains = load_gains(bringup_file('gains', gains_file))
    gains.require(arm, gains_file)
    if gains.observer.method != 'exact':
        raise ConfigError('gains', "must be of method 'exact': 'paper' has no guaranteed bound")
    return Attacker(arm, duration, gains)


def _show(count: int, found: Finding) -> None:
    print(f'  run {count}: estimate at {found.ratio:.3f} of its threshold', file=sys.stderr)


def _conclude(attacker: Attacker, found: list[Finding]) -> int:
    arm, worst = attacker.arm, found[0]
    for i, (name, unit) in enumerate(zip(arm.sensor_names, arm.position_units)):
        most = max(found, key=lambda one: one.ratios[i])
        if most.ratios[i] > 0.0:
            print(f'{name}: {most.ratios[i]:.3f} of {most.thresholds[i]:.4f} {unit}')
        else:
            print(f'{name}: no threshold that says anything')
    print(f'alarms: in {sum(one.blamed for one in found)} of {len(found)} runs')
    crossed, i = worst.ratio >= 1.0, worst.sensor
    threshold = f'{worst.thresholds[i]:.4f} {arm.position_units[i]}'
    print(f'{"CROSSED" if crossed else "no crossing"} in {len(found)} runs: '
          f'{arm.sensor_names[i]} reached {worst.ratio:.3f} of its threshold, {threshold}, at '
          f'{worst.times[i]:.2f} s')  # fmt: skip
    return 1 if crossed else 0
