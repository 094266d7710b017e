"""The ``lpv`` command."""

import argparse
import importlib
import sys
from contextlib import nullcontext

from lpv.cli.completion import complete, complete_by_name
from lpv.cli.needs import remedy, version
from lpv.cli.options import COMMANDS, module_of
from lpv.cli.progress import announced
from lpv.core.support.errors import LpvError
from lpv.core.support.options import declare
from lpv.core.support.resources import bringup_file
from lpv.core.support.threads import one_thread


def build_parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """Parser of the command line, with the options of one command."""
    parser = argparse.ArgumentParser(
        prog='lpv', description='Sensor-fault diagnosis and tracking of serial robot arms.'
    )
    parser.add_argument('--version', action='version', version=version(), help='show the version')
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name, table in COMMANDS.items():
        text, options = table.split('\n', 1)
        sub = commands.add_parser(name, help=text, description=text)
        if name == chosen:
            declare(sub, options)
            complete_by_name(sub)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Entry point; exit code 2 for bad input, 130 if interrupted."""
    complete(build_parser, COMMANDS)
    one_thread()
    is_shell, argv = argv is None, sys.argv[1:] if argv is None else argv
    chosen = next((a for a in argv if a in COMMANDS), None)
    if not argv:
        build_parser().print_help()
        return 0
    # A shell waits; who calls from Python does not want more than what the command prints.
    text = f'lpv {chosen}: {COMMANDS[chosen].splitlines()[0]}' if chosen else ''
    try:
        with announced(text) if is_shell and text else nullcontext():
            arguments = build_parser(chosen).parse_args(argv)
            if getattr(arguments, 'arm', None) and chosen != 'doctor':
                # Before all that takes its time; not for help, which needs no NumPy.
                from lpv.core.serial_arm.arm_file import load_arm

                arguments.arm_file = bringup_file('arms', arguments.arm)
                arguments.arm = load_arm(arguments.arm_file)
            module = importlib.import_module(module_of(arguments.command))
            code: int = module.run(arguments)
            return code
    except ModuleNotFoundError as error:
        print(f'lpv {chosen}: {remedy(error.name)}', file=sys.stderr)
        return 2
    except (LpvError, OSError) as error:
        print(f'lpv {chosen}: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('interrupted', file=sys.stderr)
        return 130


if __name__ == '__main__':
    sys.exit(main())
