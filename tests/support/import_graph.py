"""Which package and sub-package imports which, read from the sources."""

import ast
from collections import defaultdict
from pathlib import Path

from places import PACKAGES, ROOT


def package_folders() -> dict[str, Path]:
    """Python packages by name; lpv_design is in ``design/``, our ros2 command in ``tools/``."""
    folders = {path.name: path / path.name for path in PACKAGES.glob('lpv*')}
    folders['lpv_design'] = ROOT / 'design' / 'lpv_design'
    folders['lpv_ros2cli'] = ROOT / 'tools' / 'lpv_ros2cli' / 'lpv_ros2cli'
    return {name: path for name, path in sorted(folders.items()) if path.is_dir()}


def module_name(file: Path, package: Path) -> str:
    """Dotted name of a module file of a package."""
    parts = file.relative_to(package.parent).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def module_imports() -> dict[str, set[str]]:
    """Modules of the workspace that each module imports, lazy imports included."""
    files = {
        module_name(file, folder): file
        for folder in package_folders().values()
        for file in folder.rglob('*.py')
    }
    graph: dict[str, set[str]] = {}
    for module, file in files.items():
        found: set[str] = set()
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    inner = f'{node.module}.{alias.name}'
                    found.add(inner if inner in files else node.module)
        graph[module] = {name for name in found if name in files and name != module}
    return graph


def collapse(graph: dict[str, set[str]], depth: int) -> dict[str, set[str]]:
    """The graph between packages (depth 1) or sub-packages (depth 2)."""

    def short(module: str) -> str:
        return '.'.join(module.split('.')[:depth])

    result: dict[str, set[str]] = defaultdict(set)
    for module, imported in graph.items():
        result[short(module)].update(short(name) for name in imported)
    return {name: others - {name} for name, others in result.items()}


def levels(graph: dict[str, set[str]]) -> list[list[str]]:
    """Nodes by level, lowest first; what is left in a cycle comes last as one level.

    Raises
    ------
    ValueError
        If there is a cycle; names its nodes.
    """
    remaining, result = dict(graph), []
    while remaining:
        level = sorted(n for n, others in remaining.items() if not (others & set(remaining)))
        if not level:
            raise ValueError(f'import cycle among {sorted(remaining)}')
        result.append(level)
        for name in level:
            del remaining[name]
    return result
