"""Parameters: declared once with description, range and read-only flag."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from lpv.core.serial_arm.certificate.conditions import require_loop
from lpv.core.serial_arm.certificate.loop_gains import LoopGains, parse_loop
from lpv.core.serial_arm.certificate.model_bounds import BOUNDS
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.options import entries as table_entries
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.conditions import require
from lpv.core.uio.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    MotionCertificate,
    PaperObserverGains,
    entries,
    parse_gains,
)
from lpv.core.uio.planar import planar_model


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
            default = [0.0] if one.mark == '*' else '' if one.shown else False
        low, high = one.limits or (None, None)
        found.append(Spec(one.name, default, one.text, low, high, one.choices, read_only))
    return tuple(found)


def _of_file(specs: Iterable[Spec]) -> dict[str, Spec]:
    """Declarations of what a gains file sets, by name, in ranges that make sense at all."""
    text = '{}, from the gains file written by lpv design'.format
    return {one.name: replace(one, description=text(one.description)) for one in specs}


def _gain_fields(kind: Any, prefix: str) -> dict[str, Spec]:
    specs = []
    for name, (how, text, _, limits) in entries(kind).items():
        low, high = limits.get('low', 0.0), limits.get('high', 1e9)
        default = {'matrix': [0.0], 'number': float(low), 'text': ''}[how]
        ends = (low, high) if how == 'number' else ()
        specs.append(fixed(f'{prefix}.{name}', default, text, *ends))
    return _of_file(specs)


_FORMAT = 'format=1[1:1000]   version of the format [1]'
_HASHES = """
arm_sha256 HASH    hash of its parameters
checksum HASH      hash of the numbers as they were designed
"""
GAIN_FIELDS = {
    **_of_file(
        table(f"""
{_FORMAT}
arm_name NAME      arm that the gains are for
{_HASHES}
observer.method METHOD  exact or paper
""")
    ),
    **_gain_fields(ControllerGains, 'controller'),
}
"""Parameters below ``gains.`` that every gains file sets; see lpv.core.uio.certificate.gains."""
MOTION_FIELDS = _gain_fields(MotionCertificate, 'controller.motion')
"""Parameters below ``gains.`` of files whose certificate covers the sampled loop in motion."""
METHOD_FIELDS = {
    kind.method: _gain_fields(kind, 'observer') for kind in (ExactObserverGains, PaperObserverGains)
}
"""Parameters below ``gains.`` of each method of the observer."""
_FORMS = '\n'.join(f'model.forms.{bound} NUMBERS*  proof of {bound}' for bound in BOUNDS)
_PROOF = """
{0}.decay=0.0[0:1e6]   certified decay rate [1/s]
{0}.lyapunov NUMBERS*  Lyapunov matrix, row by row
{0}.multipliers NUMBERS*  of the sectors
""".format
LOOP_FIELDS = _of_file(
    table(f"""
{_FORMAT}
arm_name NAME      arm that the certificate is for
{_HASHES}
model_error=0.0[0:0.5]  relative error of each link's inertia [1]
rate_share=0.0[0:1]    region: share of the velocity limits [1]
model.payload=0.0[0:1e6]  largest payload over M(q) [1]
model.damping=0.0[0:1e9]  viscous friction over M(q) [1/s]
model.growth=0.0[0:1e9]  growth of M(q) at the velocity limits [1/s]
model.inertia NUMBERS*  diagonal matrix below M(q) [kg m2]
{_FORMS}
{''.join(map(_PROOF, ('motion', 'sampled', 'error')))}
error.rate_share=0.0[0:1]  share of the velocity limits [1]
error.acceleration=0.0[0:1e6]  of the path [rad/s2]
error.level=0.0[0:1e12]  level that V ends below [1]
error.bound NUMBERS*   bound of the tracking error [rad]
""")
)
"""Parameters below ``loop.`` of a serial arm's file; see lpv.core.serial_arm.certificate."""


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


def declare_gains(node: Node) -> frozenset[str]:
    """Declare the parameters of a gains file, read-only; returns those that no file sets."""
    # One parameter without a value would make a request for all of them return nothing.
    fields = {**GAIN_FIELDS, **MOTION_FIELDS}
    for of_method in METHOD_FIELDS.values():
        fields.update(of_method)
    return _declare_fields(node, 'gains', fields)


def declare_loop(node: Node) -> frozenset[str]:
    """As `declare_gains`, for the certificate of a serial arm's loop."""
    return _declare_fields(node, 'loop', LOOP_FIELDS)


def _declare_fields(node: Node, prefix: str, fields: dict[str, Spec]) -> frozenset[str]:
    unset = set()
    for name, spec in fields.items():
        full, descriptor = f'{prefix}.{name}', spec.descriptor()
        descriptor.read_only = False  # as yet, or it could not be declared again
        kind = Parameter.Type.from_parameter_value(spec.default)
        given: Parameter = node.declare_parameter(full, kind, descriptor)
        node.undeclare_parameter(full)
        if given.type_ is Parameter.Type.NOT_SET:
            unset.add(name)
        node.declare_parameter(full, spec.default, spec.descriptor())
    return frozenset(unset)


def read_gains(node: Node, arm: SerialArm, unset: frozenset[str]) -> Gains | None:
    """Verified gains by `declare_gains`, which said what is ``unset``; None without a file."""
    if 'arm_name' in unset:
        return None
    method = _gain(node, 'gains.observer.method', unset)
    own = METHOD_FIELDS.get(method, ())
    motion = [name for name in MOTION_FIELDS if name not in unset]
    nested = _nested(node, 'gains', (*GAIN_FIELDS, *own, *motion), unset)
    gains = parse_gains(nested, node.get_name())
    require(planar_model(arm), gains, node.get_name())
    return gains


def read_loop(
    node: Node, arm: SerialArm, bandwidth: float, unset: frozenset[str]
) -> LoopGains | None:
    """Verified certificate of a serial arm's loop by `declare_loop`; None if no file has one."""
    if unset == frozenset(LOOP_FIELDS):
        return None
    nested = _nested(node, 'loop', tuple(LOOP_FIELDS), unset)
    gains = parse_loop({**nested, 'bandwidth': bandwidth}, node.get_name())
    require_loop(arm, gains, node.get_name())
    return gains


def _nested(node: Node, prefix: str, names: Iterable[str], unset: frozenset[str]) -> dict[str, Any]:
    """Values of parameters as the nested mapping that their names spell."""
    nested: dict[str, Any] = {}
    for name in names:
        value = _gain(node, f'{prefix}.{name}', unset)
        *parents, leaf = name.split('.')
        level = nested
        for parent in parents:
            level = level.setdefault(parent, {})
        level[leaf] = list(value) if not isinstance(value, (str, int, float)) else value
    return nested


def _gain(node: Node, name: str, unset: frozenset[str]) -> Any:
    if name.partition('.')[2] in unset:
        raise ConfigError(
            name,
            'is not set: start the node with --params-file GAINS.yaml as written by lpv design',
            node.get_name(),
        )
    return node.get_parameter(name).value
