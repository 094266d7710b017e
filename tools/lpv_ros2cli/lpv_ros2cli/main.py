"""The ``ros2`` command of machines without ros2cli."""

import argparse
import os
import signal
import sys

from lpv.core.support.discovery import stay_local
from lpv.core.support.errors import LpvError
from lpv.core.support.signals import raising_signals
from lpv_ros2cli import bag, launch, lifecycle, node, param, run, service, topic
from lpv_ros2cli.command_line import CliError

_COMMANDS = (bag, launch, lifecycle, node, param, run, service, topic)


def build_parser() -> argparse.ArgumentParser:
    """Parser of the command line; the modules import rclpy only in what they run."""
    parser = argparse.ArgumentParser(
        prog='ros2',
        description='The everyday part of the ros2 command, for machines where ROS 2 comes from '
        'wheels without ros2cli.',
    )
    parser.set_defaults(run=None, parser=parser)
    commands = parser.add_subparsers(metavar='COMMAND')
    for module in _COMMANDS:
        text = (module.__doc__ or '').partition(': ')[2].rstrip('.\n')
        command = commands.add_parser(module.__name__.split('.')[-1], help=text, description=text)
        command.set_defaults(parser=command)
        verbs = None if hasattr(module, 'run') else command.add_subparsers(metavar='VERB')
        for run_verb in [f for name, f in vars(module).items() if name.startswith('run')]:
            verb, text = command, (run_verb.__doc__ or '').partition('.')[0]
            if verbs is not None:
                verb = verbs.add_parser(run_verb.__name__[4:], help=text, description=text)
            for names, options in run_verb.arguments:
                verb.add_argument(*names, **options)
            verb.set_defaults(run=run_verb)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Entry point; exit codes as those of ros2cli."""
    parser = build_parser()
    if '_ARGCOMPLETE' in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
    arguments = parser.parse_args(argv)
    if arguments.run is None:
        arguments.parser.print_help()
        return 0
    if argv is None:
        # Of the program itself: a signal during its last moments must not change its exit code.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    stay_local()
    with raising_signals() as received:
        try:
            code = arguments.run(arguments) or 0
            sys.stdout.flush()
            return code
        except (CliError, LpvError) as error:
            print(error, file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            return int(signal.SIGINT)
        except BrokenPipeError:  # the reader, head for instance, has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except Exception:
            # An interrupt that falls into a call of the middleware comes out as another exception.
            if signal.SIGINT in received:
                return int(signal.SIGINT)
            raise


if __name__ == '__main__':
    sys.exit(main())
