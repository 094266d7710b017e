"""Namespaces of launched nodes."""


def join_namespaces(outer: str, inner: str) -> str:
    """Namespace inside another one."""
    if inner.startswith('/'):
        outer = ''
    return '/'.join(['', *filter(None, f'{outer}/{inner}'.split('/'))]).rstrip('/')
