"""Python expressions of launch files and filters, without what could do harm."""

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, TypeGuard

from lpv_ros2cli.errors import CliError

_LONGEST = 10000
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(math, name)
    for name in (
        'sqrt',
        'sin',
        'cos',
        'tan',
        'asin',
        'acos',
        'atan',
        'atan2',
        'exp',
        'log',
        'floor',
        'ceil',
        'radians',
        'degrees',
        'hypot',
    )
}
_FUNCTIONS.update(
    {
        'abs': abs,
        'min': min,
        'max': max,
        'round': round,
        'int': int,
        'float': float,
        'str': str,
        'bool': bool,
        'len': len,
    }
)
_CONSTANTS = {'pi': math.pi, 'e': math.e, 'inf': math.inf, 'true': True, 'false': False}
_ERRORS = (ArithmeticError, TypeError, ValueError, LookupError, RecursionError, MemoryError)


def evaluate(text: str) -> Any:
    """Value of an expression of ``$(eval ...)``."""
    return Expression(text, f'$(eval {text[:100]})').value({})


class Expression:
    """Arithmetic, comparisons, conditionals, subscripts, functions of ``math``; nothing else.

    Attributes are read of messages only, and only their fields.
    """

    def __init__(self, text: str, what: str) -> None:
        self._what = what
        if len(text) > _LONGEST:
            raise CliError(f'{what}: the expression is too long')
        try:
            self._tree = ast.parse(text.strip(), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise CliError(f'{what}: {error}') from error

    def value(self, names: Mapping[str, object]) -> Any:
        """Value where the names stand for these objects."""
        self._names = {**_CONSTANTS, **names}
        try:
            return self._value(self._tree)
        except _ERRORS as error:
            raise CliError(f'{self._what}: {error}') from error

    def _value(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float, str, bool)):
            return node.value
        if isinstance(node, ast.Name) and node.id in self._names:
            return self._names[node.id]
        if isinstance(node, ast.Attribute):
            return self._attribute(node)
        if isinstance(node, (ast.List, ast.Tuple)):
            return [self._value(item) for item in node.elts]
        if isinstance(node, ast.IfExp):
            return self._value(node.body if self._value(node.test) else node.orelse)
        if isinstance(node, ast.Subscript):
            return self._value(node.value)[self._value(node.slice)]
        return self._operation(node)

    def _attribute(self, node: ast.Attribute) -> Any:
        if _is_math(node) and node.attr in _CONSTANTS:
            return _CONSTANTS[node.attr]
        if not (isinstance(node.value, ast.Name) and node.value.id not in self._names):
            owner = self._value(node.value)
            if node.attr in getattr(owner, 'get_fields_and_field_types', dict)():
                return getattr(owner, node.attr)
        raise self._not_covered(node)

    def _operation(self, node: ast.expr) -> Any:
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            left, right = self._value(node.left), self._value(node.right)
            return _binary(_BINARY[type(node.op)], left, right)
        if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
            return _UNARY[type(node.op)](self._value(node.operand))
        if isinstance(node, ast.BoolOp):
            return self._boolean(node)
        if isinstance(node, ast.Compare) and all(type(op) in _COMPARE for op in node.ops):
            return self._comparison(node)
        if isinstance(node, ast.Call) and not node.keywords:
            name = node.func.attr if _is_math(node.func) else getattr(node.func, 'id', None)
            if name in _FUNCTIONS:
                return _FUNCTIONS[name](*map(self._value, node.args))
        raise self._not_covered(node)

    def _comparison(self, node: ast.Compare) -> bool:
        left = self._value(node.left)
        for op, right in zip(node.ops, map(self._value, node.comparators)):
            if not _COMPARE[type(op)](left, right):
                return False
            left = right
        return True

    def _boolean(self, node: ast.BoolOp) -> Any:
        stop_at = isinstance(node.op, ast.Or)
        value = None
        for item in node.values:
            value = self._value(item)
            if bool(value) == stop_at:
                break
        return value

    def _not_covered(self, node: ast.expr) -> CliError:
        return CliError(
            f'{self._what}: {ast.unparse(node)!r} is not covered; covered are arithmetic, '
            'comparisons, and, or, not, in, if-else and functions of math'
        )


def _is_math(node: ast.expr) -> TypeGuard[ast.Attribute]:
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == 'math'
    )


def _binary(operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    # A repeated text or list could fill the memory.
    if operation is operator.mul and not all(isinstance(v, (int, float)) for v in (left, right)):
        raise TypeError('only numbers can be multiplied')
    if operation is operator.mod and isinstance(left, str):
        raise TypeError('texts cannot be formatted')
    return operation(left, right)
