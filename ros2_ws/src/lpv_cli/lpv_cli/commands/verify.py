"""``lpv verify``: check the certificate of a gains file, without any solver."""

import argparse
from typing import Any

import numpy as np

from lpv_core.certificate.claims import CLAIMS
from lpv_core.certificate.conditions import Check, verify
from lpv_core.certificate.gains import Gains, load_gains
from lpv_core.model.arm import ArmParameters, arm_from_json, load_arm
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
    gains = load_gains(arguments.gains)
    arm = _arm(arguments, gains)
    holds = True
    observer: Any = gains.observer
    print(f'gains for arm {arm.name!r}, method {observer.method!r}')
    print('largest eigenvalue of each inequality, which holds where that is negative:')
    for check in [*verify(arm, gains), *_map_check(arm, gains)]:
        holds &= check.holds
        print(f'  {"holds" if check.holds else "FAILS"}  {check.margin:+10.3g}  {check.name}')
    if arguments.proof:
        from lpv_core.certificate.exact_proof import prove

        for name, proved in prove(arm, gains).items():
            holds &= proved
            print(f'  {"proved" if proved else "REFUTED"}  {name}')
    print('what is claimed, where, and by which evidence:')
    for claim in CLAIMS:
        print(f'  {claim.text}\n    where: {claim.region}\n    evidence: {claim.evidence}')
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
