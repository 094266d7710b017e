"""Parameters: declared once with description, range and read-only flag; services for them."""

import array
import os
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

from rcl_interfaces import msg
from rcl_interfaces.msg import ParameterDescriptor, ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

from lpv.core.serial_arm.certificate.certified import CertifiedGains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.options import Entry, entries
from lpv.core.support.resources import bringup_file

_Kind = TypeVar('_Kind', bound=CertifiedGains)


def table(text: str) -> tuple[Entry, ...]:
    """Declarations of a table as of `lpv.core.support.options`; switches are off by default."""
    return tuple(
        one if one.default is not None else one._replace(default='' if one.shown else False)
        for one in entries(text)
    )


def _descriptor(entry: Entry, read_only: bool) -> ParameterDescriptor:
    result = ParameterDescriptor(description=entry.text, read_only=read_only)
    if entry.choices:
        result.additional_constraints = 'one of ' + ', '.join(entry.choices)
    if entry.limits is None:
        return result
    low, high = entry.limits
    if isinstance(entry.default, float):
        result.floating_point_range = [msg.FloatingPointRange(from_value=low, to_value=high)]
    else:
        result.integer_range = [msg.IntegerRange(from_value=int(low), to_value=int(high))]
    return result


QUOTE_WORDS = 'in YAML on, off, yes and no are truth values unless quoted, in a shell as \'"off"\''
"""What to do where a truth value came for a text."""


def declare(node: Node, declared: Iterable[Entry], read_only: bool = True) -> None:
    """Declare parameters, of the type of their defaults.

    Strings outside their choices are refused, now (ConfigError) and later.
    """
    choices = {}
    for one in declared:
        choices[one.name] = one.choices
        try:
            descriptor = _descriptor(one, read_only)
            value = node.declare_parameter(one.name, one.default, descriptor).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            given = node._parameter_overrides.get(one.name)
            is_word = isinstance(one.default, str) and given and isinstance(given.value, bool)
            reason = f'{error}; {QUOTE_WORDS}' if is_word else str(error)
            raise ConfigError(one.name, reason, node.get_name()) from error
        if one.choices and value not in one.choices:
            reason = f'must be one of {", ".join(one.choices)}, got {value!r}'
            raise ConfigError(one.name, reason, node.get_name())

    def check(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            allowed = choices.get(parameter.name)
            if allowed and parameter.value not in allowed:
                reason = f'{parameter.name} must be one of {", ".join(allowed)}'
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def required_path(node: Node, name: str, reason: str = 'must be set') -> str:
    """Path in a string parameter; ConfigError with the reason if it is empty."""
    value = node.get_parameter(name).value
    if not value:
        raise ConfigError(name, reason, node.get_name())
    return os.path.expanduser(value)  # no shell does behind :=


def named_file(node: Node, name: str, kind: str) -> str:
    """Path in a parameter, or of the shipped file of a kind that it names; ConfigError without."""
    reason = f'must be set, for launch files as {name}:=...'
    return str(bringup_file(kind, required_path(node, name, reason)))


FROM_GAINS = '0: as the gains allow'
"""What a limit of latency means that was not set."""


def chosen_limit(node: Node, name: str, certified: float) -> float:
    """Value of a parameter, or what the gains allow if it is 0 [s]; a warning if it is longer."""
    value = float(node.get_parameter(name).value)
    if value > certified:
        node.get_logger().warning(
            f'{name}: {value:g} s is longer than the {certified:.3g} s that the gains allow; '
            'the loop may become unstable before the arm is stopped'
        )
    return value or certified


def declare_given(node: Node, *files: str) -> None:
    """Declare what gains files set below ``gains`` or ``loop``, read-only; but for the
    certificate's, from which nothing is computed."""
    for name, given in node._parameter_overrides.items():
        file, _, rest = name.partition('.')
        if file in files and not rest.startswith('certificate.'):
            text = 'of the gains file written by lpv design'
            # The reader of the file checks types, and says what is wrong.
            own = ParameterDescriptor(description=text, read_only=True, dynamic_typing=True)
            node.declare_parameter(name, given.value, own)


def read_gains(node: Node, arm: SerialArm, kind: type[_Kind], **others: Any) -> _Kind | None:
    """Verified gains of a kind that the node was started with; None without a file.

    ``others`` are what parameters of their own say.
    """
    nested = dict(others)
    given = node.get_parameters_by_prefix(kind.section)
    for name, parameter in given.items():
        *parents, leaf = name.split('.')
        level, value = nested, parameter.value
        for parent in parents:
            level = level.setdefault(parent, {})
        level[leaf] = list(value) if isinstance(value, array.array) else value
    if not given:
        return None
    gains = kind.parse(nested, node.get_name())
    gains.require(arm, node.get_name())
    return gains


class CheckedParameterService(ParameterService):
    """rclpy's services without requests that end the process: of unknown types, or deletions."""

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        response.results = [self._set([message]) for message in request.parameters]
        return response

    def _set_parameters_atomically_callback(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        response.result = self._set(request.parameters)
        return response

    def _set(self, messages: Sequence[msg.Parameter]) -> SetParametersResult:
        reason = next(filter(None, map(self._refusal, messages)), '')
        try:
            if not reason:
                wanted = [Parameter.from_parameter_msg(message) for message in messages]
                return self._get_node().set_parameters_atomically(wanted)
        except Exception as error:  # of any type: rclpy does not check what it is sent
            reason = f'{type(error).__name__}: {error}'
        return SetParametersResult(successful=False, reason=reason)

    def _refusal(self, message: msg.Parameter) -> str:
        """Why a parameter cannot have a value; empty if it may."""
        node, name, given = self._get_node(), message.name, message.value.type
        if not name:
            return 'a parameter needs a name'
        if given == ParameterType.PARAMETER_NOT_SET:
            return f'{name} cannot be deleted'
        if given not in [kind.value for kind in Parameter.Type]:
            return ''  # its error says so
        if not node.has_parameter(name):
            return f'{node.get_name()} has no parameter {name}'
        wanted = node.get_parameter(name).type_
        if node.describe_parameter(name).dynamic_typing or given == wanted.value:
            return ''
        reason = f'{name} is of type {wanted.name}, not {Parameter.Type(given).name}'
        is_word = (wanted, given) == (Parameter.Type.STRING, ParameterType.PARAMETER_BOOL)
        return f'{reason}; {QUOTE_WORDS}' if is_word else reason
