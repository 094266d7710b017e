"""``lpv falsify``: search for a healthy run that crosses its threshold."""

import argparse
import sys
from pathlib import Path

from lpv_campaign.falsify.result_files import BAG, SCENARIO, read_attack, write_worst
from lpv_campaign.falsify.search import Attacker, Finding, search
from lpv_cli.completion import shipped
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import load_gains
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file

EXIT_CROSSED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arm = parser.add_argument('--arm', required=True, help='arm file, or name of a shipped arm')
    arm.completer = shipped('arms')  # type: ignore[attr-defined]
    parser.add_argument('--gains', required=True, help='gains file, or name of a shipped one')
    parser.add_argument(
        '--evaluations', type=int, default=20_000, help='runs (default: %(default)s)'
    )
    parser.add_argument(
        '--duration', type=float, default=6.0, help='of a run [s] (default: %(default)s)'
    )
    parser.add_argument('--seed', type=int, default=0, help='of the search (default: %(default)s)')
    parser.add_argument('--repeat', metavar=SCENARIO, help='only run this attack again')
    parser.add_argument('--out', default='out/falsify', help='folder (default: %(default)s)')


def run(arguments: argparse.Namespace) -> int:
    """Search, write the worst run, and say whether a threshold was crossed."""
    arm = load_arm(bringup_file('arms', arguments.arm))
    gains = load_gains(bringup_file('gains', arguments.gains))
    require(arm, gains, arguments.gains)
    if gains.observer.method != 'exact':
        raise ConfigError('gains', "must be of method 'exact': 'paper' has no guaranteed bound")
    if arguments.repeat:
        attack, duration = read_attack(arguments.repeat)
        return _conclude(arm, Attacker(arm, gains, duration).run(attack), 1)
    if arguments.evaluations < 1 or not 0.0 < arguments.duration <= 3600.0:
        raise ConfigError('--evaluations, --duration', 'must be positive, and at most 3600 s')
    attacker = Attacker(arm, gains, arguments.duration)
    worst = search(attacker, arguments.evaluations, arguments.seed, _show)
    write_worst(attacker, worst, arguments.out)
    folder = Path(arguments.out)
    print(f'worst run: {folder / SCENARIO}, {folder / BAG}')
    return _conclude(arm, worst, arguments.evaluations)


def _show(count: int, found: Finding) -> None:
    print(f'  run {count}: estimate at {found.ratio:.3f} of its threshold', file=sys.stderr)


def _conclude(arm: ArmParameters, worst: Finding, count: int) -> int:
    crossed = worst.ratio >= 1.0
    outcome = 'CROSSED' if crossed else 'no crossing'
    print(
        f'{outcome} in {count} runs: {arm.sensor_names[worst.sensor]} '
        f'reached {worst.ratio:.3f} of its threshold, {worst.threshold:.4f} rad, at '
        f'{worst.time:.2f} s'
    )
    return EXIT_CROSSED if crossed else 0
