"""``ros2 launch``: run a launch file in XML."""

import argparse
import ast
import json
import os
import re
import shlex
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from lpv.core.support.limits import MAX_DEPTH
from lpv.core.support.resources import executable, prefix_of
from lpv_ros2cli.command_line import CliError, takes
from lpv_ros2cli.messages import parse_yaml
from lpv_ros2cli.processes import Processes, Program

_ATTRIBUTES = {
    'launch': 'version',
    'arg': 'name default description value',
    'choice': 'value',
    'let': 'name value',
    'set_env': 'name value',
    'include': 'file',
    'group': '',
    'push-ros-namespace': 'namespace',
    'node': 'pkg exec name output args ros_args respawn respawn_delay on_exit',
    'param': 'name value from',
    'remap': 'from to',
}
"""Of the elements that are covered, beside ``if`` and ``unless``."""
_SHOW_ARGS = ('-s', '--show-args')
_SUBSTITUTION = re.compile(r'\$\(([a-z-]+)')


@takes(*_SHOW_ARGS, action='store_true', help='show what the file takes')
@takes('package_or_file', help='package, or path of a launch file')
@takes('words', nargs='...', metavar='[file] name:=value')
def run(arguments: argparse.Namespace) -> int:
    """Run a launch file; 1 if a process ended with an error before everything was stopped."""
    path = Path(arguments.package_or_file)
    words = [word for word in arguments.words if word not in _SHOW_ARGS]
    show_args = arguments.show_args or words != arguments.words
    if not path.is_file():
        if path.name != arguments.package_or_file or path.suffix:
            raise CliError(f"launch file '{path}' does not exist")
        known = {
            file.name: file
            for file in sorted((prefix_of(path.name) / 'share' / path.name).rglob('*.launch.xml'))
        }
        if not words or words[0] not in known:
            raise CliError(f"name a launch file of package '{path}': {', '.join(known)}")
        path, words = known[words[0]], words[1:]
    given = {}
    for word in words:
        name, found, given[name] = word.partition(':=')
        if not found or not name:
            raise CliError(f"malformed launch argument '{word}', expected format '<name>:=<value>'")
    launch = Launch(given, show_args)
    launch.include(path)
    if show_args:
        print(launch.description())
        return 0
    return Processes(launch.programs).run()


class Launch:
    """A launch file with all that it includes.

    ``given`` are launch arguments of the command line.  With ``only_declared`` it collects the
    arguments that the files take, given or not, and no programs.
    """

    def __init__(self, given: dict[str, str], only_declared: bool = False) -> None:
        self.programs: list[Program] = []
        self._only_declared = only_declared
        self._declared: dict[str, tuple[str, str | None, list[str]]] = {}
        self._values, self._environment, self._namespace = dict(given), dict(os.environ), ''
        self._passed: set[str] = set()  # to the file that is read
        self._files: list[Path] = []  # that are read: each includes the next

    def description(self) -> str:
        """Text of ``--show-args``."""
        lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
        for name, (text, default, choices) in self._declared.items():
            text += f'. Valid choices are: {choices}' if choices else ''
            lines += ['', f"    '{name}':", f'        {text}']
            lines += [] if default is None else [f"        (default: '{default}')"]
        return '\n'.join(lines if self._declared else [*lines, '', '  No arguments.'])

    def include(self, path: Path, passed: Iterable[str] = ()) -> None:
        """Evaluate a file."""
        if len(self._files) > MAX_DEPTH:
            raise CliError(f'{path}: included by itself, or nested too deeply')
        try:
            root = ET.fromstring(path.read_text('utf-8'))
        except (OSError, UnicodeDecodeError, ET.ParseError) as error:
            raise CliError(f'launch file {path} cannot be read: {error}') from error
        outer, self._passed = self._passed, set(passed)
        self._files.append(path.absolute())
        for element in root.iter():  # a typing error, or not covered here
            known = f'{_ATTRIBUTES.get(element.tag, "")} if unless'.split()
            for name in {*element.attrib} - {*known}:
                raise self._error(element, f"attribute '{name}' is not covered by this ros2")
        self._evaluate(root)
        self._files.pop()
        self._passed = outer

    def _error(self, element: ET.Element, reason: str) -> CliError:
        name = element.get('name') or element.get('exec') or ''
        return CliError(f'{self._files[-1]}: <{" ".join([element.tag, name]).strip()}>: {reason}')

    def _evaluate(self, parent: ET.Element) -> None:
        for element in parent:
            action = getattr(self, '_' + element.tag.replace('-', '_'), None)
            try:
                if action is None or element.tag not in _ATTRIBUTES:
                    raise ValueError(f'is not covered by this ros2 in <{parent.tag}>')
                if self._only_declared or (
                    self._truth(element, 'if', 'true') and not self._truth(element, 'unless')
                ):
                    action(element)
            except ValueError as error:
                raise self._error(element, str(error)) from error

    def _truth(self, element: ET.Element, name: str, default: str = 'false') -> bool:
        text = self._text(element, name, default).strip().lower()
        if text not in ('true', 'false', '1', '0'):
            raise ValueError(f"'{name}' must be true or false, got {text!r}")
        return text in ('true', '1')

    def _text(self, element: ET.Element, name: str, default: str | None = None) -> str:
        text = element.get(name, default)
        if text is None:
            raise ValueError(f"attribute '{name}' of <{element.tag}> is missing")
        return self._scan(text, 0, '')[0]

    def _arg(self, element: ET.Element) -> None:
        name, default = self._text(element, 'name'), element.get('default')
        choices = [self._text(choice, 'value') for choice in element]
        if name not in self._passed:
            text = element.get('description', 'no description given')
            self._declared.setdefault(name, (text, default, choices))
        if name not in self._values:
            if default is None and not self._only_declared:
                raise ValueError(f'required launch argument: give {name}:=...')
            self._values[name] = self._text(element, 'default', '')
        if choices and self._values[name] not in choices:
            raise ValueError(f'must be one of {", ".join(choices)}; got {self._values[name]!r}')

    def _let(self, element: ET.Element) -> None:
        self._values[self._text(element, 'name')] = self._text(element, 'value')

    def _set_env(self, element: ET.Element) -> None:
        self._environment[self._text(element, 'name')] = self._text(element, 'value')

    def _push_ros_namespace(self, element: ET.Element) -> None:
        pushed = self._text(element, 'namespace').strip('/')
        self._namespace += f'/{pushed}' if pushed else ''

    def _group(self, element: ET.Element) -> None:
        outer = dict(self._values), dict(self._environment), self._namespace
        self._evaluate(element)
        self._values, self._environment, self._namespace = outer

    def _include(self, element: ET.Element) -> None:
        # As in ros2cli: what is given to an included file stays set after it.
        passed = {self._text(a, 'name'): self._text(a, 'value') for a in element}
        self._values.update(passed)
        self.include(Path(self._text(element, 'file')), passed)

    def _node(self, element: ET.Element) -> None:
        if self._only_declared:
            return
        package, program = self._text(element, 'pkg'), self._text(element, 'exec')
        command = [str(executable(package, program)), *self._words(element, 'args'), '--ros-args']
        command += self._words(element, 'ros_args')
        if element.get('name') is not None:
            command += ['-r', f'__node:={self._text(element, "name")}']
        if self._namespace:
            command += ['-r', f'__ns:={self._namespace}']
        for child in element:
            if child.tag == 'remap':
                command += ['-r', f'{self._text(child, "from")}:={self._text(child, "to")}']
            elif child.get('from') is not None:
                command += ['--params-file', self._text(child, 'from')]
            else:
                value = _parameter(self._text(child, 'value'))
                command += ['-p', f'{self._text(child, "name")}:={value}']
        self.programs.append(
            Program(
                name=f'{program}-{len(self.programs) + 1}',
                command=command,
                environment=dict(self._environment),
                respawn=self._truth(element, 'respawn'),
                respawn_delay=float(self._text(element, 'respawn_delay', '0')),
                ends_all=self._text(element, 'on_exit', '') == 'shutdown',
                grace=float(self._values.get('sigterm_timeout', '5')),
            )
        )

    def _words(self, element: ET.Element, name: str) -> list[str]:
        """Words of a command line; what a substitution gives is not split."""
        return shlex.split(self._scan(element.get(name, ''), 0, '', shlex.quote)[0])

    def _scan(
        self, text: str, position: int, ends: str, quoted: Callable[[str], str] = str
    ) -> tuple[str, int]:
        """Perform up to one of the characters ``ends``; the result, and where it ended."""
        result = ''
        while position < len(text) and text[position] not in ends:
            found = _SUBSTITUTION.match(text, position)
            if not found:
                result += text[position]
                position += 1
                continue
            words, position = list[str](), found.end()
            while text[position : position + 1] != ')':
                if position >= len(text):
                    raise ValueError(f"{text!r}: '$(' is not closed")
                quote = text[position] if text[position] in '\'"' else ''
                if text[position] == ' ':
                    position += 1
                    continue
                word, position = self._scan(text, position + len(quote), quote or ' )')
                words.append(word)
                position += len(quote)
            result += quoted(self._substitute(found[1], *words))
            position += 1
        return result, position

    def _substitute(self, name: str, *words: str) -> str:
        match name, words:
            case 'var' | 'env', (key, *default) if len(default) < 2:
                values = self._values if name == 'var' else self._environment
                if key not in values and not default:
                    raise ValueError(f"'$({name} {key})' does not exist")
                return values[key] if key in values else default[0]
            case 'find-pkg-share', (package,):
                return str(prefix_of(package) / 'share' / package)
            case 'dirname', ():
                return str(self._files[-1].parent)
            case 'eval', (expression,):
                try:
                    return str(_value(ast.parse(expression, mode='eval').body))
                except (SyntaxError, TypeError) as error:
                    raise ValueError(f'$(eval {expression}): {error}') from error
        raise ValueError(f"substitution '$({name} ...)' is not covered by this ros2")


def _value(node: ast.expr) -> Any:
    """Value of an expression of texts, without what could do harm."""
    match node:
        case ast.Constant(value=str() | int() | float() as constant):
            return constant
        case ast.IfExp(test=test, body=body, orelse=orelse):
            return _value(body if _value(test) else orelse)
        case ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]):
            return _value(left) == _value(right)
        case ast.Compare(left=left, ops=[ast.In()], comparators=[right]):
            return _value(left) in _value(right)
    raise ValueError(f'{ast.unparse(node)!r} is not covered by this ros2')


def _parameter(text: str) -> str:
    """A parameter's value for a command line: texts are quoted, whatever they look like."""
    value = parse_yaml(text, 'the value of a parameter')
    return json.dumps(text) if isinstance(value, (str, dict, type(None))) else text
