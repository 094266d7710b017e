"""Python expressions of ``$(eval ...)``, without what could do harm."""

import ast
import math
import operator
from collections.abc import Callable
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


def evaluate(text: str) -> object:
    """Value of an expression of numbers, texts, lists and comparisons."""
    if len(text) > _LONGEST:
        raise CliError('$(eval ...): the expression is too long')
    try:
        return _value(ast.parse(text.strip(), mode='eval').body)
    except CliError:
        raise
    except (
        SyntaxError,
        ArithmeticError,
        TypeError,
        ValueError,
        IndexError,
        KeyError,
        RecursionError,
        MemoryError,
    ) as error:
        raise CliError(f'$(eval {text}): {error}') from error


def _value(node: ast.expr) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float, str, bool)):
        return node.value
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return _CONSTANTS[node.id]
    if isinstance(node, ast.Attribute) and _is_math(node) and node.attr in _CONSTANTS:
        return _CONSTANTS[node.attr]
    if isinstance(node, (ast.List, ast.Tuple)):
        return [_value(item) for item in node.elts]
    if isinstance(node, ast.IfExp):
        return _value(node.body if _value(node.test) else node.orelse)
    if isinstance(node, ast.Subscript):
        return _value(node.value)[_value(node.slice)]
    return _operation(node)


def _operation(node: ast.expr) -> Any:
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return _binary(_BINARY[type(node.op)], _value(node.left), _value(node.right))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](_value(node.operand))
    if isinstance(node, ast.BoolOp):
        return _boolean(node)
    if isinstance(node, ast.Compare) and all(type(op) in _COMPARE for op in node.ops):
        left = _value(node.left)
        for op, right in zip(node.ops, map(_value, node.comparators)):
            if not _COMPARE[type(op)](left, right):
                return False
            left = right
        return True
    if isinstance(node, ast.Call) and not node.keywords:
        name = node.func.attr if _is_math(node.func) else getattr(node.func, 'id', None)
        if name in _FUNCTIONS:
            return _FUNCTIONS[name](*map(_value, node.args))
    raise CliError(
        f'$(eval ...): {ast.unparse(node)!r} is not covered; covered are arithmetic, '
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


def _boolean(node: ast.BoolOp) -> Any:
    stop_at = isinstance(node.op, ast.Or)
    value = None
    for item in node.values:
        value = _value(item)
        if bool(value) == stop_at:
            break
    return value
