"""Parameters: declared once with description, range and read-only flag."""

from collections.abc import Iterable
from dataclasses import dataclass

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterUninitializedException,
)
from rclpy.parameter import Parameter

from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import parse_gains
from lpv_core.support.errors import ConfigError

_ARRAY, _DOUBLE, _STRING, _INTEGER = (
    Parameter.Type.DOUBLE_ARRAY,
    Parameter.Type.DOUBLE,
    Parameter.Type.STRING,
    Parameter.Type.INTEGER,
)


@dataclass(frozen=True)
class Spec:
    """Declaration of one parameter.

    Attributes
    ----------
    name : str
        Name.
    default : object
        Default value; its type is the parameter's type.
    description : str
        What it means, with its unit.
    low, high : float or int, optional
        Allowed range.
    choices : tuple of str, optional
        Allowed strings.
    read_only : bool, optional
        Whether it is fixed once the node runs.
    """

    name: str
    default: object
    description: str
    low: float = None
    high: float = None
    choices: tuple = ()
    read_only: bool = False

    def descriptor(self):
        """The ROS descriptor of this parameter."""
        result = ParameterDescriptor(description=self.description, read_only=self.read_only)
        if self.choices:
            result.additional_constraints = 'one of ' + ', '.join(self.choices)
        if self.low is not None and isinstance(self.default, float):
            result.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
            ]
        elif self.low is not None:
            result.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high))]
        return result


@dataclass(frozen=True)
class GainField:
    """Declaration of one parameter of the gains file: no default, read-only.

    Attributes
    ----------
    kind : rclpy.parameter.Parameter.Type
        Type.
    description : str
        What it means, with its unit.
    low, high : float or int, optional
        Range that makes sense at all; what must hold is checked with the certificate.
    """

    kind: Parameter.Type
    description: str
    low: float = None
    high: float = None

    def descriptor(self):
        """The ROS descriptor of this parameter."""
        like = {_DOUBLE: 0.0, _INTEGER: 0}.get(self.kind, '')
        return Spec(
            '',
            like,
            self.description + ', from the gains file written by lpv design',
            self.low,
            self.high,
            read_only=True,
        ).descriptor()


FORMAT_FIELD = GainField(_INTEGER, 'version of the format [1]', 1, 1000)
GAIN_FIELDS = {
    'arm_name': GainField(_STRING, 'arm that the gains are for'),
    'arm_sha256': GainField(_STRING, 'hash of its parameters'),
    'checksum': GainField(_STRING, 'hash of the numbers as they were designed'),
    'observer.method': GainField(_STRING, 'exact or paper'),
    'observer.lyapunov': GainField(_ARRAY, 'Lyapunov matrices of the observer, row by row'),
    'observer.fault_sigma': GainField(_ARRAY, 'standard deviations of the fault estimates [rad]'),
    'controller.method': GainField(_STRING, 'exact or paper'),
    'controller.m1': GainField(_ARRAY, 'M1, row by row [N m/rad], [N m s/rad]'),
    'controller.m2': GainField(_ARRAY, 'M2, row by row [N m/(rad s)]'),
    'controller.lyapunov': GainField(_ARRAY, 'Lyapunov matrix of the controller, row by row'),
    'controller.decay': GainField(_DOUBLE, 'certified decay rate of the loop [1/s]', 0.0, 1e6),
    'controller.sinc_min': GainField(_DOUBLE, 'lower end of the box [1]', -1.0, 1.0),
}
"""Parameters below ``gains.`` that every gains file sets; see lpv_core.certificate.gains."""
METHOD_FIELDS = {
    'exact': {
        'kappa': GainField(_ARRAY, 'kappa of both links [1/(kg m2)]'),
        'mu': GainField(_ARRAY, 'mu of both links [1/s]'),
        'decay': GainField(_DOUBLE, 'certified slowest pole of the error [1/s]', 0.0, 1e6),
        'fastest': GainField(_DOUBLE, 'certified fastest pole of the error [1/s]', 0.0, 1e6),
    },
    'paper': {
        't1': GainField(_ARRAY, 'T1, row by row'),
        't2': GainField(_ARRAY, 'T2, row by row'),
        'k': GainField(_ARRAY, 'K of all vertices, row by row'),
        'box': GainField(_ARRAY, 'ranges of phi1, phi2, phi3'),
        'lmi': GainField(_STRING, 'inequalities that hold'),
        'gamma': GainField(_DOUBLE, 'attenuation level [1]', 0.0, 1e9),
        'q': GainField(_DOUBLE, "distance of the disc's centre [1/s]", 0.0, 1e6),
        'r': GainField(_DOUBLE, 'radius of the disc [1/s]', 0.0, 1e6),
    },
}
"""Parameters below ``gains.observer.`` of each method."""


def declare(node, specs: Iterable[Spec]) -> None:
    """Declare parameters and refuse strings outside their choices, now and later.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    specs : iterable of Spec
        Declarations.

    Raises
    ------
    ConfigError
        If an override has the wrong type, is out of range or not among the choices.
    """
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

    def check(parameters):
        for parameter in parameters:
            allowed = choices.get(parameter.name)
            if allowed and parameter.value not in allowed:
                reason = f'{parameter.name} must be one of {", ".join(allowed)}'
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def required_text(node, name: str) -> str:
    """Value of a string parameter that must be set.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    name : str
        Parameter.

    Returns
    -------
    str
        Not empty.

    Raises
    ------
    ConfigError
        If it is empty.
    """
    value = node.get_parameter(name).value
    if not value:
        raise ConfigError(name, 'must be set', node.get_name())
    return value


def declare_gains(node) -> None:
    """Declare the parameters of a gains file, read-only, without defaults.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    """
    fields = {'format': FORMAT_FIELD, **GAIN_FIELDS}
    for of_method in METHOD_FIELDS.values():
        fields.update({f'observer.{name}': field for name, field in of_method.items()})
    for name, field in fields.items():
        node.declare_parameter(f'gains.{name}', field.kind, field.descriptor())


def read_gains(node, arm):
    """Gains from a node's parameters, with their certificate verified.

    Parameters
    ----------
    node : rclpy.node.Node
        A node on which `declare_gains` was called.
    arm : ArmParameters
        The arm that they must be made for.

    Returns
    -------
    Gains
        Validated.

    Raises
    ------
    ConfigError
        If no gains file was given, it is not valid, of another arm, or its certificate does not
        hold.
    """
    nested = {}
    method = _gain(node, 'observer.method')
    own = [f'observer.{name}' for name in METHOD_FIELDS.get(method, ())]
    for name in ('format', *GAIN_FIELDS, *own):
        value = _gain(node, name)
        *parents, leaf = name.split('.')
        level = nested
        for parent in parents:
            level = level.setdefault(parent, {})
        level[leaf] = list(value) if not isinstance(value, (str, int, float)) else value
    gains = parse_gains(nested, node.get_name())
    require(arm, gains, node.get_name())
    return gains


def _gain(node, name):
    try:
        return node.get_parameter(f'gains.{name}').value
    except ParameterUninitializedException:
        raise ConfigError(
            f'gains.{name}',
            'is not set: start the node with --params-file GAINS.yaml as written by lpv design',
            node.get_name(),
        ) from None
