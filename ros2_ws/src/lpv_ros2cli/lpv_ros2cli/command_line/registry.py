"""Commands and verbs: where each is implemented, and what it does in one line."""

_PACKAGE = 'lpv_ros2cli'

VERBS = {
    'bag': (
        'record, play and inspect bags',
        {
            'info': 'print information about a bag',
            'play': 'publish the messages of a bag',
            'record': 'record topics into a bag',
        },
    ),
    'interface': (
        'show information about message and service types',
        {
            'list': 'list the interface types that are available',
            'package': 'list the interface types of a package',
            'packages': 'list the packages that have interfaces',
            'proto': 'print an interface with default values',
            'show': 'print the definition of an interface type',
        },
    ),
    'lifecycle': (
        'managed nodes',
        {
            'get': 'get the lifecycle state of one or more nodes',
            'list': 'list the transitions of a node',
            'nodes': 'list the nodes that have a lifecycle',
            'set': 'trigger a lifecycle transition',
        },
    ),
    'node': (
        'nodes',
        {'info': 'print information about a node', 'list': 'list the nodes that are available'},
    ),
    'param': (
        'parameters',
        {
            'delete': 'delete a parameter',
            'describe': 'show descriptions of declared parameters',
            'dump': 'print the parameters of a node as a parameter file',
            'get': 'get a parameter',
            'list': 'list the parameters that are declared',
            'load': 'load a parameter file into a node',
            'set': 'set a parameter',
        },
    ),
    'pkg': (
        'packages',
        {
            'executables': 'list the programs of packages',
            'list': 'list the packages that are available',
            'prefix': 'print the prefix of a package',
        },
    ),
    'service': (
        'services',
        {
            'call': 'call a service',
            'find': 'list the services of a type',
            'info': 'print information about a service',
            'list': 'list the services that are available',
            'type': 'print the type of a service',
        },
    ),
    'topic': (
        'topics',
        {
            'bw': 'print the bandwidth of a topic',
            'delay': 'print the delay of a topic with a header',
            'echo': 'print the messages of a topic',
            'find': 'list the topics of a type',
            'hz': 'print the rates of topics',
            'info': 'print information about a topic',
            'list': 'list the topics that are available',
            'pub': 'publish messages to a topic',
            'type': 'print the type of a topic',
        },
    ),
}
"""Commands with verbs: one line about each, and about each verb."""

COMMANDS = {
    'doctor': 'check the set-up of ROS on this machine',
    'launch': 'run a launch file',
    'run': 'run a program of a package',
}
"""Commands without verbs."""

_SYNONYMS = {'wtf': 'doctor'}


def canonical(command: str) -> str:
    """Name of a command, without synonyms."""
    return _SYNONYMS.get(command, command)


def module_of(command: str, verb: str | None = None) -> str:
    """Module that implements a command or a verb.

    It has ``add_arguments(parser)`` and ``run(arguments)``, which returns an exit code or None.
    """
    if verb is not None:
        return f'{_PACKAGE}.{command}.{verb}'
    return f'{_PACKAGE}.launch.command' if command == 'launch' else f'{_PACKAGE}.{command}'
