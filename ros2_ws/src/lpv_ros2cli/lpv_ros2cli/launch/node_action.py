"""Actions ``node`` and ``executable``: the command line of a process."""

import shlex
from dataclasses import dataclass
from typing import Any

from lpv_ros2cli.launch.context import Context
from lpv_ros2cli.launch.entity import Entity
from lpv_ros2cli.launch.names import join_namespaces
from lpv_ros2cli.launch.parameters import parameter_sources
from lpv_ros2cli.launch.substitutions import parse
from lpv_ros2cli.packages import executable

_PRIVATE_USE = 0xE000  # characters that no text has
_OUTPUTS = ('screen', 'log', 'both', 'own_log', 'full')


@dataclass
class ProcessSpec:
    """A process to start."""

    name: str  # prefix of its lines, without number
    command: list[str | dict[str, Any]]  # a dict stands for the parameter file written from it
    environment: dict[str, str]  # the whole one
    outline: str  # one line about it
    output: str = 'log'  # screen, log, both, own_log or full
    cwd: str | None = None  # working directory
    respawn: bool = False  # start again when it ends
    respawn_delay: float = 0.0  # wait before that [s]
    respawn_max_retries: int = -1  # how often; -1: without limit
    shutdown_on_exit: bool = False  # stop everything when it ends
    sigterm_timeout: float = 5.0  # from SIGINT to SIGTERM [s]
    sigkill_timeout: float = 5.0  # from SIGTERM to SIGKILL [s]
    is_node: bool = False  # a ROS node itself, which handles SIGTERM once it has started


def node_process(context: Context, entity: Entity) -> ProcessSpec:
    """Process of a ``node`` element."""
    package = context.perform(entity.required('pkg'))
    program = context.perform(entity.required('exec'))
    name, namespace = entity.text('name'), entity.text('namespace')
    command: list[str | dict[str, Any]] = [
        str(executable(package, program)),
        *_words(context, entity, 'args'),
        '--ros-args',
        *_words(context, entity, 'ros_args'),
    ]
    if name is not None:
        command += ['-r', f'__node:={context.perform(name)}']
    if namespace is not None or context.scope.namespace:
        full = join_namespaces(context.scope.namespace, context.perform(namespace or ''))
        command += ['-r', f'__ns:={full or "/"}']
    for source in parameter_sources(context, entity):
        command += ['--params-file', source]
    remaps = [
        *context.scope.remaps,
        *(
            (context.perform(r.required('from')), context.perform(r.required('to')))
            for r in entity.all('remap')
        ),
    ]
    for old, new in remaps:
        command += ['-r', f'{old}:={new}']
    label = context.perform(entity.text('exec_name') or program)
    process = _process(context, entity, label, command, f'{package}/{program}')
    process.is_node = process.command == command  # not a prefix that runs it
    return process


def program_process(context: Context, entity: Entity) -> ProcessSpec:
    """Process of an ``executable`` element."""
    command = [*_words(context, entity, 'cmd'), *_words(context, entity, 'args')]
    if not command:
        raise entity.error("attribute 'cmd' is missing")
    if entity.flag('shell', False):
        command = ['/bin/sh', '-c', ' '.join(command)]
    name = context.perform(entity.text('name') or command[0].rpartition('/')[2])
    return _process(context, entity, name, command, shlex.join(command))


def _words(context: Context, entity: Entity, attribute: str) -> list[str]:
    """Words of a command line; what a substitution gives is never split, as upstream."""
    text = entity.text(attribute)
    if text is None:
        return []
    values: dict[str, str] = {}
    template = ''
    for part in parse(text):
        if isinstance(part, str):
            template += part
        else:
            mark = chr(_PRIVATE_USE + len(values))
            values[mark] = context.perform_one(part)
            template += mark
    try:
        words = shlex.split(template)
    except ValueError as error:
        raise entity.error(f"'{attribute}': {error}") from error
    return [''.join(values.get(c, c) for c in word) for word in words]


def _process(
    context: Context, entity: Entity, name: str, command: list[Any], outline: str
) -> ProcessSpec:
    environment = dict(context.scope.environment)
    for variable in entity.all('env'):
        key = context.perform(variable.required('name'))
        environment[key] = context.perform(variable.required('value'))
        variable.finish()
    output = context.perform(
        entity.text('output', environment.get('OVERRIDE_LAUNCH_PROCESS_OUTPUT', 'log'))
    )
    if output not in _OUTPUTS:
        raise entity.error(f"'output' must be one of {', '.join(_OUTPUTS)}; got {output!r}")
    on_exit = entity.text('on_exit')
    if on_exit not in (None, 'shutdown'):
        raise entity.error(f"'on_exit' must be shutdown, got {on_exit!r}")
    entity.flag('emulate_tty', False)  # lines come through pipes in any case
    cwd = entity.text('cwd')
    configurations = context.scope.configurations
    return ProcessSpec(
        name,
        [*_words(context, entity, 'launch-prefix'), *command],
        environment,
        outline,
        output,
        cwd if cwd is None else context.perform(cwd),
        entity.boolean('respawn', context.perform(entity.text('respawn', 'false'))),
        _number(context, entity, 'respawn_delay', '0'),
        int(_number(context, entity, 'respawn_max_retries', '-1')),
        on_exit is not None,
        _number(context, entity, 'sigterm_timeout', configurations.get('sigterm_timeout', '5')),
        _number(context, entity, 'sigkill_timeout', configurations.get('sigkill_timeout', '5')),
    )


def _number(context: Context, entity: Entity, attribute: str, default: str) -> float:
    text = context.perform(entity.text(attribute, default))
    try:
        return float(text)
    except ValueError:
        raise entity.error(f"'{attribute}' must be a number, got {text!r}") from None
