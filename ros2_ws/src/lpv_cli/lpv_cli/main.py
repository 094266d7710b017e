"""The ``lpv`` command."""

import argparse
import importlib
import sys
from contextlib import nullcontext

from lpv_cli.completion import complete, complete_by_name
from lpv_cli.needs import Version, remedy
from lpv_cli.progress import announced
from lpv_core.support.errors import LpvError

COMMANDS = {
    'design': ('lpv_cli.commands.design', 'design certified gains for an arm'),
    'verify': ('lpv_cli.commands.verify', 'check the certificate of a gains file'),
    'falsify': ('lpv_cli.commands.falsify', 'search for healthy runs that cross a threshold'),
    'demo': ('lpv_cli.commands.demo', 'design, simulate with the real graph, record, report'),
    'doctor': ('lpv_cli.doctor', 'find the usual mistakes in files, environment and graph'),
    'campaign': ('lpv_cli.campaigns.campaign', 'run thousands of simulations, and report on them'),
    'fleet': ('lpv_cli.campaigns.fleet', 'replay an archive of bags, and report on all of them'),
    'tune': ('lpv_cli.campaigns.tune', 'search the weights of a design by campaigns of runs'),
    'run': ('lpv_cli.commands.run', 'start a node, as ros2 run does'),
    'identify': ('lpv_cli.commands.identify', 'identify an arm from recordings of its motion'),
    'excite': ('lpv_cli.commands.excite', 'plan a motion that identifies an arm well'),
    'import-csv': ('lpv_cli.commands.import_csv', 'turn a CSV recording of an arm into a bag'),
    'replay': ('lpv_cli.replaying.replay', 'run observer and diagnosis offline on a bag'),
    'view': ('lpv_cli.commands.view', 'show the running graph: web page, Foxglove, markers'),
    'init': ('lpv_cli.commands.init', 'write commented files of an arm to start from'),
    'urdf': ('lpv_cli.commands.urdf', 'print the URDF of an arm'),
    'recover': ('lpv_cli.commands.recover', 'repair a bag that is cut off or damaged'),
    'compare': ('lpv_cli.commands.compare', 'compare the answers in two bags of one recording'),
    'report': ('lpv_cli.commands.report', 'write the report of a bag'),
}
"""Command names, the modules that implement them (``add_arguments``, ``run``), one-line helps.

A module declares arguments without importing what only its ``run`` needs: help must not wait.
"""


def build_parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='lpv', description='Sensor-fault diagnosis and tracking of serial robot arms.'
    )
    parser.add_argument('--version', action=Version)
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name, (module, text) in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text)
        if name == chosen:
            implementation = importlib.import_module(module)
            implementation.add_arguments(sub)
            complete_by_name(sub)
            sub.set_defaults(run=implementation.run)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Entry point; exit code 2 for bad input."""
    complete(build_parser, COMMANDS)
    is_shell, argv = argv is None, sys.argv[1:] if argv is None else argv
    chosen = next((a for a in argv if a in COMMANDS), None)
    if not argv:
        build_parser().print_help()
        return 0
    # A shell waits; who calls from Python does not want more than what the command prints.
    waiting = announced(f'lpv {chosen}: {COMMANDS[chosen][1]}') if is_shell and chosen else None
    try:
        with waiting or nullcontext():
            arguments = build_parser(chosen).parse_args(argv)
            return arguments.run(arguments)
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
