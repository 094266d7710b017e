"""Actions of launch files: evaluates an element tree into the processes to start."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.context import Context
from lpv_ros2cli.launch.entity import Entity, LaunchFileError
from lpv_ros2cli.launch.files import read_launch_file
from lpv_ros2cli.launch.names import join_namespaces
from lpv_ros2cli.launch.node_action import ProcessSpec, node_process, program_process


@dataclass
class Plan:
    """What a launch will do."""

    processes: list[ProcessSpec] = field(default_factory=list)  # in the order of the file
    messages: list[str] = field(default_factory=list)  # of ``log``
    outline: list[tuple[int, str]] = field(default_factory=list)  # depth, and one line per action


def evaluate_file(context: Context, path: str | Path, plan: Plan | None = None) -> Plan:
    """Evaluate a launch file with all that it includes."""
    plan = Plan() if plan is None else plan
    root = read_launch_file(path)
    with context.inside(Path(path).absolute()):
        children = root.children()
        root.get('version')  # of the schema; upstream ignores it too
        root.finish()
        for entity in children:
            evaluate(context, entity, plan)
    return plan


def evaluate(context: Context, entity: Entity, plan: Plan) -> None:
    """Evaluate one action, if its conditions hold."""
    action = ACTIONS.get(entity.tag)
    if action is None:
        raise entity.error(f'is not covered by this ros2; covered here: {", ".join(ACTIONS)}')
    try:
        if _holds(context, entity):
            action(context, entity, plan)
            entity.finish()
    except LaunchFileError:
        raise
    except CliError as error:
        raise entity.error(str(error)) from error


def _holds(context: Context, entity: Entity) -> bool:
    conditions = [(name, entity.text(name)) for name in ('if', 'unless')]
    if all(text is not None for _, text in conditions):
        raise entity.error("'if' and 'unless' exclude each other")
    for name, text in conditions:
        if text is not None:
            return entity.boolean(name, context.perform(text)) == (name == 'if')
    return True


def _note(context: Context, plan: Plan, text: str) -> None:
    plan.outline.append((context.depth, text))


def _arg(context: Context, entity: Entity, plan: Plan) -> None:
    name = entity.required('name')
    default = entity.text('default')
    entity.text('description')
    if name not in context.scope.configurations:
        if default is None:
            raise entity.error(
                f"required launch argument '{name}' was not provided (give {name}:=...)"
            )
        context.scope.configurations[name] = context.perform(default)
    value = context.scope.configurations[name]
    choices = [choice.required('value') for choice in entity.all('choice')]
    if choices and value not in choices:
        raise entity.error(f"'{name}' must be one of {', '.join(choices)}; got {value!r}")
    _note(context, plan, f'arg {name} = {value!r}')


def _let(context: Context, entity: Entity, plan: Plan) -> None:
    name, value = entity.required('name'), context.perform(entity.required('value'))
    context.scope.configurations[name] = value
    _note(context, plan, f'let {name} = {value!r}')


def _set_env(context: Context, entity: Entity, plan: Plan) -> None:
    name = context.perform(entity.required('name'))
    value = context.perform(entity.required('value'))
    context.scope.environment[name] = value
    _note(context, plan, f'set_env {name} = {value!r}')


def _append_env(context: Context, entity: Entity, plan: Plan) -> None:
    name = context.perform(entity.required('name'))
    value = context.perform(entity.required('value'))
    separator, first = entity.text('separator', ':'), entity.flag('prepend', False)
    parts = [context.scope.environment[name]] if context.scope.environment.get(name) else []
    parts.insert(0 if first else len(parts), value)
    context.scope.environment[name] = separator.join(parts)
    _note(context, plan, f'append_env {name}: {value!r}')


def _unset_env(context: Context, entity: Entity, plan: Plan) -> None:
    name = context.perform(entity.required('name'))
    context.scope.environment.pop(name, None)
    _note(context, plan, f'unset_env {name}')


def _push_namespace(context: Context, entity: Entity, plan: Plan) -> None:
    pushed = context.perform(entity.required('namespace'))
    context.scope.namespace = join_namespaces(context.scope.namespace, pushed)
    _note(context, plan, f'push_ros_namespace {pushed}')


def _set_parameter(context: Context, entity: Entity, plan: Plan) -> None:
    name, value = entity.required('name'), context.perform(entity.required('value'))
    context.scope.parameters.append((name, value))
    _note(context, plan, f'set_parameter {name} = {value!r}')


def _set_remap(context: Context, entity: Entity, plan: Plan) -> None:
    pair = context.perform(entity.required('from')), context.perform(entity.required('to'))
    context.scope.remaps.append(pair)
    _note(context, plan, f'set_remap {pair[0]} -> {pair[1]}')


def _log(context: Context, entity: Entity, plan: Plan) -> None:
    entity.text('level')
    message = context.perform(entity.required('message'))
    plan.messages.append(message)
    _note(context, plan, f'log {message!r}')


def _group(context: Context, entity: Entity, plan: Plan) -> None:
    scoped, forwarding = entity.flag('scoped', True), entity.flag('forwarding', True)
    if not forwarding:
        raise entity.error("'forwarding' is not covered by this ros2")
    _note(context, plan, 'group')
    context.depth += 1
    with context.group() if scoped else contextlib.nullcontext():
        for child in entity.children():
            evaluate(context, child, plan)
    context.depth -= 1


def _include(context: Context, entity: Entity, plan: Plan) -> None:
    path = context.perform(entity.required('file'))
    _note(context, plan, f'include {path}')
    # As upstream: what is given to an included file stays set after it.
    for argument in (*entity.all('arg'), *entity.all('let')):
        name, value = argument.required('name'), context.perform(argument.required('value'))
        argument.finish()
        context.scope.configurations[name] = value
    evaluate_file(context, path, plan)


def _node(context: Context, entity: Entity, plan: Plan) -> None:
    process = node_process(context, entity)
    plan.processes.append(process)
    _note(context, plan, f'node {process.outline}')


def _executable(context: Context, entity: Entity, plan: Plan) -> None:
    process = program_process(context, entity)
    plan.processes.append(process)
    _note(context, plan, f'executable {process.outline}')


ACTIONS: dict[str, Callable[[Context, Entity, Plan], None]] = {
    'arg': _arg,
    'let': _let,
    'node': _node,
    'executable': _executable,
    'group': _group,
    'include': _include,
    'push_ros_namespace': _push_namespace,
    'push-ros-namespace': _push_namespace,
    'set_env': _set_env,
    'append_env': _append_env,
    'unset_env': _unset_env,
    'set_parameter': _set_parameter,
    'set_remap': _set_remap,
    'log': _log,
}
"""Actions by their element's name."""
