"""Which package and sub-package imports which, read from the sources."""

import ast
from collections import defaultdict
from functools import cache

from places import PACKAGES, ROOT


def package_folders():
    """Python packages by name; our ros2 command is in ``tools/``."""
    folders = {path.name: path / path.name for path in PACKAGES.glob('lpv*')}
    folders['lpv_ros2cli'] = ROOT / 'tools' / 'lpv_ros2cli' / 'lpv_ros2cli'
    return {name: path for name, path in sorted(folders.items()) if path.is_dir()}


@cache
def module_files():
    files = [
        (file.relative_to(folder.parent).with_suffix(''), file)
        for folder in package_folders().values()
        for file in sorted(folder.rglob('*.py'))
    ]
    return {'.'.join(name.parts).removesuffix('.__init__'): file for name, file in files}


@cache
def parsed(file):
    tree = ast.parse(file.read_text(encoding='utf-8'))
    nodes = ast.walk(tree)
    return tree.body, [one for one in nodes if isinstance(one, (ast.Import, ast.ImportFrom))]


def imports(file, known=()):
    """Modules that a file imports; of those known also what is in them."""
    for node in parsed(file)[1]:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif not node.level:
            for alias in node.names:
                inner = f'{node.module}.{alias.name}'
                yield inner if inner in known else node.module


@cache
def module_imports():
    files = module_files()
    return {m: ({*imports(file, files)} & files.keys()) - {m} for m, file in files.items()}


def collapse(depth):
    """The graph between packages (depth 1) or sub-packages (depth 2)."""
    short = {module: '.'.join(module.split('.')[:depth]) for module in module_files()}
    result = defaultdict(set)
    for module, imported in module_imports().items():
        result[short[module]].update(short[name] for name in imported)
    return {name: others - {name} for name, others in result.items()}
