"""Namespaces of launched nodes."""


def join_namespaces(outer: str, inner: str) -> str:
    """Namespace inside another one.

    Parameters
    ----------
    outer, inner : str
        Namespaces; an absolute inner one stands alone.

    Returns
    -------
    str
        Absolute namespace, empty for the root.
    """
    if inner.startswith('/'):
        outer = ''
    return '/'.join(['', *filter(None, f'{outer}/{inner}'.split('/'))]).rstrip('/')
