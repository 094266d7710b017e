"""Parameters: declared once with description, range and read-only flag."""

import array
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from lpv.core.serial_arm.certificate.certified import CertifiedGains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.options import entries as table_entries
from lpv.core.support.resources import bringup_file

_Kind = TypeVar('_Kind', bound=CertifiedGains)


@dataclass(frozen=True)
class Spec:
    """Declaration of one parameter."""

    name: str
    default: Any  # its type is the parameter's type
    description: str  # meaning, with the unit
    low: float | None = None  # allowed range
    high: float | None = None
    choices: tuple[str, ...] = ()  # allowed strings
    read_only: bool = False  # fixed once the node runs

    def descriptor(self) -> ParameterDescriptor:
        """The ROS descriptor of this parameter."""
        result = ParameterDescriptor(description=self.description, read_only=self.read_only)
        if self.choices:
            result.additional_constraints = 'one of ' + ', '.join(self.choices)
        if self.low is None or self.high is None:
            return result
        if isinstance(self.default, float):
            result.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
            ]
        else:
            result.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high))]
        return result


fixed = partial(Spec, read_only=True)
"""Declaration of a parameter that is fixed once the node runs."""


def table(text: str, read_only: bool = True) -> tuple[Spec, ...]:
    """Declarations of a table as of `lpv.core.support.options`; switches are off by default."""
    found = []
    for one in table_entries(text):
        default = one.default
        if default is None:
            default = '' if one.shown else False
        low, high = one.limits or (None, None)
        found.append(Spec(one.name, default, one.text, low, high, one.choices, read_only))
    return tuple(found)


def declare(node: Node, specs: Iterable[Spec]) -> None:
    """Declare parameters and refuse, now (ConfigError) and later, strings outside their choices."""
    specs = tuple(specs)
    choices = {spec.name: spec.choices for spec in specs if spec.choices}
    for spec in specs:
        try:
            value = node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise ConfigError(spec.name, str(error), node.get_name()) from error
        if spec.choices and value not in spec.choices:
            raise ConfigError(
                spec.name,
                f'must be one of {", ".join(spec.choices)}, got {value!r}',
                node.get_name(),
            )

    def check(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            allowed = choices.get(parameter.name)
            if allowed and parameter.value not in allowed:
                reason = f'{parameter.name} must be one of {", ".join(allowed)}'
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def required_text(node: Node, name: str) -> str:
    """Value of a string parameter; ConfigError if it is empty."""
    value = node.get_parameter(name).value
    if not value:
        raise ConfigError(name, 'must be set', node.get_name())
    return value


def named_file(node: Node, name: str, kind: str) -> str:
    """Path in a parameter, or of the shipped file of a kind that it names; ConfigError without."""
    return str(bringup_file(kind, required_text(node, name)))


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
