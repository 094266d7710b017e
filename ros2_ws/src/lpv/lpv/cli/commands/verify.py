"""``lpv verify``: check the certificate of a gains file, without any solver."""

import argparse

from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import load_certified
from lpv.report.certificate import described_arm


def run(arguments: argparse.Namespace) -> int:
    """Rebuild and judge every inequality; 1 if one does not hold."""
    found = load_certified(bringup_file('gains', arguments.gains))
    arm = arguments.arm or described_arm(found)
    if arm is None:
        raise ConfigError('--arm', 'is needed: the gains do not describe theirs', arguments.gains)
    checks, proved = found.verify(arm), found.prove(arm) if arguments.proof else {}
    holds = all(check.holds for check in checks) and all(proved.values())
    print(f'{found.what} of arm {arm.name!r}', *found.facts(arm), sep='\n')
    print('largest eigenvalue of each inequality, which holds where that is negative:')
    for check in checks:
        print(f'  {"holds" if check.holds else "FAILS"}  {check.margin:+10.3g}  {check.name}')
    for name, is_proved in proved.items():
        print(f'  {"proved" if is_proved else "REFUTED"}  {name}')
    print('what is claimed, where, and by which evidence:')
    for claim, region, evidence in found.claims():
        print(f'  {claim}\n    where: {region}\n    evidence: {evidence}')
    print('the certificate holds' if holds else 'the certificate does NOT hold')
    return 0 if holds else 1
