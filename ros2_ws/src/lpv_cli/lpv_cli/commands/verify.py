"""``lpv verify``: check the certificate of a gains file, without any solver."""

import argparse

from lpv_cli.options import flag


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('gains', help='gains file as written by lpv design')
    parser.add_argument(
        '--arm',
        help='arm that the gains are to be used with: file or name of a '
        'shipped one; without, the arm that the file itself describes',
    )
    flag(parser, '--proof', 'also prove the inequalities in exact rational arithmetic')


def run(arguments: argparse.Namespace) -> int:
    """Rebuild and judge every inequality.

    Exit code: 0; 1 if an inequality does not hold.
    """
    from lpv_cli.progress import wrapped
    from lpv_core.serial_arm.arm_file import load_arm
    from lpv_core.support.errors import ConfigError
    from lpv_core.support.resources import bringup_file
    from lpv_report.certificate import load_certified

    found = load_certified(arguments.gains)
    name = arguments.arm
    arm = load_arm(bringup_file('arms', name)) if name else found.arm()
    if arm is None:
        raise ConfigError('--arm', 'is needed: the gains do not describe theirs', arguments.gains)
    checks, proved = found.checks(arm), found.prove(arm) if arguments.proof else {}
    holds = all(check.holds for check in checks) and all(proved.values())
    with wrapped():
        print(f'{found.what} of arm {arm.name!r}', *found.facts(arm), sep='\n')
        print('largest eigenvalue of each inequality, which holds where that is negative:')
        for check in checks:
            print(f'  {"holds" if check.holds else "FAILS"}  {check.margin:+10.3g}  {check.name}')
        for name, is_proved in proved.items():
            print(f'  {"proved" if is_proved else "REFUTED"}  {name}')
        print('what is claimed, where, and by which evidence:')
        for claim in found.claims:
            print(f'  {claim.text}\n    where: {claim.region}\n    evidence: {claim.evidence}')
        print('the certificate holds' if holds else 'the certificate does NOT hold')
    return 0 if holds else 1
