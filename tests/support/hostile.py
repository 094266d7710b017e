"""Hostile messages, parameters and requests, and what a node made of them."""

import math
from contextlib import ExitStack, contextmanager

import numpy as np
import rclpy
import ros
from diagnostic_msgs.msg import DiagnosticStatus
from fuzzing import fuzz
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.serialization import deserialize_message, serialize_message

from lpv.core.support.errors import LpvError

FLOATS = (
    0.0, -1.0, 10.0, -10.0, 1e3, -1e6, 1e12, 1e150, 1e300, -1e300, 1.7e308, -1.7e308, 5e-324,
    math.nan, math.inf, -math.inf,
)  # fmt: skip
"""Numbers that fit the type: absurd, at the ends of it, and none at all."""
STAMPS = ((0, 0), (-(2**31), 0), (-1, 10**9 - 1), (2**31 - 1, 0), (5, 2**32 - 1))
TEXTS = ('', 'x', 'link1_angle', 'joint1', '\u2603' * 50, '<script>', 'a' * 10_000, '%s%n')
INTEGERS = (0, -1, 1, 2**63 - 1, -(2**63), 10**6)
RECOVERY = 1_000_000_000
"""Longest time of data from the last bad input to a node that works again [ns]."""


class Refused(LpvError):
    """A node did not take an input, and said why."""


def leaves(message):
    """(owner, name, type) of all fields that hold no message themselves."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            yield from leaves(value)
        else:
            yield message, name, kind


def sized(message):
    """A message whose numbers are there for two joints."""
    values = {'sequence<double>': 0.1, 'sequence<uint8>': 0, 'sequence<boolean>': False}
    for owner, name, kind in leaves(message):
        if kind in values:
            setattr(owner, name, [values[kind]] * 2)
    return message


def set_anything(rng, owner, name, kind):
    one = {
        **dict.fromkeys(('double', 'float'), lambda: float(rng.choice(FLOATS))),
        'int64': lambda: int(rng.choice(INTEGERS)), 'uint8': lambda: int(rng.integers(256)),
        'octet': lambda: bytes([rng.integers(256)]), 'boolean': lambda: bool(rng.integers(2)),
        'string': lambda: TEXTS[rng.integers(len(TEXTS))],
        'diagnostic_msgs/DiagnosticStatus': lambda: fill(rng, DiagnosticStatus()),
    }  # fmt: skip
    if name == 'sec':
        owner.sec, owner.nanosec = STAMPS[rng.integers(len(STAMPS))]
    elif kind in one:
        setattr(owner, name, one[kind]())
    elif kind.startswith('double['):
        setattr(owner, name, rng.choice(FLOATS, len(getattr(owner, name))))
    elif kind.startswith('sequence<') and kind[9:-1] in one:
        setattr(owner, name, [one[kind[9:-1]]() for _ in range(rng.integers(0, 5))])


def fill(rng, message):
    for field in list(leaves(message)):
        set_anything(rng, *field)
    return message


def forge(rng, message):
    """Change a good message: one to three fields, single elements of arrays, or all of it."""
    if rng.random() < 0.3:
        return fill(rng, message)
    fields = list(leaves(message))
    for k in rng.integers(len(fields), size=rng.integers(1, 4)):
        owner, name, kind = fields[k]
        values = getattr(owner, name)
        if kind.startswith(('double[', 'sequence<double>')) and len(values):
            values[rng.integers(len(values))] = float(rng.choice(FLOATS))
        else:
            set_anything(rng, owner, name, kind)
    return message


def damaged_bytes(rng, message):
    """A message as it may come from a sender of another type: cut, or with other bytes."""
    data = bytearray(serialize_message(message))
    if rng.random() < 0.5:
        return bytes(data[: rng.integers(len(data) + 1)])
    for place in rng.integers(len(data), size=rng.integers(1, 20)):
        data[place] = rng.integers(256)
    return bytes(data)


def numbers(message):
    return {
        f'{type(owner).__name__}.{name}': np.array(getattr(owner, name), float)
        for owner, name, kind in leaves(message)
        if 'double' in kind or 'float' in kind
    }


class Output:
    """Takes the place of a publisher: keeps messages, and their numbers since `take`."""

    def __init__(self, kind):
        self._kind, self._kept, self.sent = kind, [], []

    def publish(self, message):
        if isinstance(message, bytes):
            message = deserialize_message(message, self._kind)
        self.sent.append(message)
        self._kept.append(numbers(message))

    @property
    def last(self):
        return self.sent[-1] if self.sent else None

    def take(self):
        kept, self._kept = self._kept, []
        return kept

    def get_subscription_count(self):
        return 1


@contextmanager
def node_of(kind, *files, **parameters):
    """A configured node of a class in this process, that takes part without an executor."""
    given = ros.words(*(f'{key}:={value}' for key, value in parameters.items()), files=files)
    rclpy.init(args=given, domain_id=ros.next_domain())
    with ExitStack() as ends:
        ends.callback(rclpy.shutdown)
        node = kind()
        ends.callback(node.destroy_node)
        node.setup()
        node._taking_part = True
        yield node


def run_cases(count, case, **options):
    """Counts of a fuzzer whose cases take a generator of their own."""
    seeds = []
    return fuzz(count, seeds.append, lambda: case(np.random.default_rng(seeds[-1])), **options)


def parameter(rng, names):
    """A parameter of a node, or none of it, with a value of any type."""
    value = fill(rng, ParameterValue())
    value.type = int(rng.integers(12))
    return Parameter(name=str(rng.choice([*names, 'x', '', 'use_sim_time'])), value=value)


def answers_to(service, wanted, together):
    """Results of setting parameters, all together or one by one."""
    if together:
        kind, set_all = SetParametersAtomically, service._set_parameters_atomically_callback
        return [set_all(kind.Request(parameters=wanted), kind.Response()).result]
    request = SetParameters.Request(parameters=wanted)
    return service._set_parameters_callback(request, SetParameters.Response()).results


def set_parameters(node, rng):
    """Set one to three parameters of a node as a service request does; its finite values."""
    names = sorted(node._parameters)
    wanted = [parameter(rng, names) for _ in range(rng.integers(1, 4))]
    results = answers_to(node._checked_parameters, wanted, rng.random() < 0.5)
    reasons = [result.reason for result in results if not result.successful]
    assert all(reasons), 'refused without a reason'
    if len(reasons) == len(results):
        raise Refused(' '.join(reasons[0].split())[:300])
    declared = node.get_parameters([name for name in names if not name.startswith('gains.')])
    return {p.name: p.value for p in declared if isinstance(p.value, float)}


def request(callback, kind, rng, good):
    """Call a service in this process with a hostile request; refusals are `Refused`."""
    answer = callback(forge(rng, kind.Request(**good)), kind.Response())
    if not answer.success:
        assert answer.message, 'refused without a reason'
        raise Refused(answer.message)
    return answer.message
