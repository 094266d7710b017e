"""``lpv verify``: check the certificate of a gains file, without any solver."""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_core.certificate.claims import CLAIMS, SERIAL_CLAIMS, Claim
from lpv_core.certificate.conditions import Check, verify
from lpv_core.certificate.gains import Gains, load_gains
from lpv_core.model.arm import ArmParameters, arm_from_json, load_arm
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.serial_arm.certificate.conditions import region_lines, verify_loop
from lpv_core.serial_arm.certificate.loop_gains import load_loop_gains, serial_parameters
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file
from lpv_design.guarantee import guarantee


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('gains', help='gains file as written by lpv design')
    parser.add_argument(
        '--arm',
        help='arm that the gains are to be used with: file or name of a '
        'shipped one; without, the arm that the file itself describes',
    )
    parser.add_argument(
        '--proof',
        action='store_true',
        help='also prove the inequalities in exact rational arithmetic',
    )


def run(arguments: argparse.Namespace) -> int:
    """Rebuild and judge every inequality.

    Exit code: 0; 1 if an inequality does not hold.
    """
    if serial_parameters(arguments.gains) is not None:
        return _verify_loop(arguments)
    gains = load_gains(arguments.gains)
    arm = _arm(arguments, gains)
    observer: Any = gains.observer
    print(f'gains for arm {arm.name!r}, method {observer.method!r}')
    proved = {}
    if arguments.proof:
        from lpv_core.certificate.exact_proof import prove

        proved = prove(arm, gains)
    return _judge([*verify(arm, gains), *_map_check(arm, gains)], proved, CLAIMS)


def _verify_loop(arguments: argparse.Namespace) -> int:
    """The certificate of a serial arm's loop."""
    gains = load_loop_gains(arguments.gains)
    arm = load_any_arm(bringup_file('arms', arguments.arm or gains.arm_name))
    if not isinstance(arm, SerialArm):
        raise ConfigError('--arm', f'{arm.name!r} is no serial arm', arguments.gains)
    print(f'tracking of the serial arm {arm.name!r}')
    checks, proved = verify_loop(arm, gains), {}
    print('\n'.join(region_lines(arm, gains)))
    if arguments.proof:
        from lpv_core.serial_arm.certificate.exact_proof import prove_loop

        proved = prove_loop(arm, gains)
    return _judge(checks, proved, SERIAL_CLAIMS)


def _judge(checks: list[Check], proved: dict[str, bool], claims: Sequence[Claim]) -> int:
    """Print all; the exit code."""
    print('largest eigenvalue of each inequality, which holds where that is negative:')
    for check in checks:
        print(f'  {"holds" if check.holds else "FAILS"}  {check.margin:+10.3g}  {check.name}')
    for name, is_proved in proved.items():
        print(f'  {"proved" if is_proved else "REFUTED"}  {name}')
    print('what is claimed, where, and by which evidence:')
    for claim in claims:
        print(f'  {claim.text}\n    where: {claim.region}\n    evidence: {claim.evidence}')
    holds = all(check.holds for check in checks) and all(proved.values())
    print('the certificate holds' if holds else 'the certificate does NOT hold')
    return 0 if holds else 1


def _map_check(arm: ArmParameters, gains: Gains) -> list[Check]:
    """The map of thresholds at rest, information in the file, as recomputed."""
    stored = gains.certificate.get('guarantee')
    if stored is None:
        return []
    found = guarantee(arm, gains).to_dict()
    try:
        same = stored.keys() == found.keys() and all(
            len(stored[name]) == len(found[name])
            and np.allclose(stored[name], found[name], rtol=1e-6, atol=0.0)
            for name in found
        )
    except (AttributeError, TypeError, ValueError):  # no map of numbers at all
        same = False
    return [Check('information: map of thresholds at rest as recomputed', -1.0 if same else 1.0)]


def _arm(arguments: argparse.Namespace, gains: Gains) -> ArmParameters:
    if arguments.arm:
        return load_arm(bringup_file('arms', arguments.arm))
    if 'arm_json' not in gains.certificate:
        raise ConfigError(
            'gains.certificate.arm_json', 'is missing: give the arm with --arm', arguments.gains
        )
    return arm_from_json(gains.certificate['arm_json'])
