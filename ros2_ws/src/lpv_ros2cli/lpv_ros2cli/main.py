"""The ``ros2`` command of machines without ros2cli."""

import os
import signal
import sys

from lpv_core.support.discovery import stay_local
from lpv_node.signals import raising_signals
from lpv_ros2cli.command_line.completion import complete
from lpv_ros2cli.command_line.parsing import parse
from lpv_ros2cli.errors import CliError


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    if argv is None:
        # Of the program itself: a signal during its last moments must not change its exit code.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    complete()
    stay_local()
    with raising_signals() as received:
        try:
            return _run(sys.argv[1:] if argv is None else argv)
        except CliError as error:
            print(error, file=sys.stderr)
            return error.code
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


def _run(argv: list[str]) -> int:
    arguments = parse(argv)
    if arguments.run is None:
        arguments.parser.print_help()
        return 0
    code = arguments.run(arguments) or 0
    sys.stdout.flush()
    return code


if __name__ == '__main__':
    sys.exit(main())
