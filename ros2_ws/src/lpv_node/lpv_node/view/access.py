"""Who may see the page, and who may press its buttons."""

import contextlib
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterable, Mapping
from typing import Any

from lpv.core.support.errors import ConfigError

MOST_CLIENTS = 16
"""Clients of a port, and commands of theirs that may wait or be under way."""
_SHORTEST_TOKEN = 16
"""Characters of a token: 64 bits in hexadecimal."""


class Access:
    """Decides on requests by their headers, and on commands by their token."""

    # A page of another site in the operator's browser can send requests here; its ``Origin`` gives
    # it away.  With DNS rebinding that site's name points here: ``Host`` is that name, and no
    # address.  Without a token there is none on the loopback address, a random one elsewhere.

    def __init__(
        self, address: str, token: str = '', hosts: Iterable[str] = (), origins: Iterable[str] = ()
    ) -> None:
        known = _address('127.0.0.1' if address == 'localhost' else address)
        if known is None:
            reason = 'must be localhost or an IP address; 0.0.0.0 stands for all of this machine'
            raise ConfigError('address', f'{address!r} {reason}')
        loopback = known.is_loopback
        if token and len(token) < _SHORTEST_TOKEN:
            raise ConfigError('token', f'must have at least {_SHORTEST_TOKEN} characters')
        self.token = token or ('' if loopback else secrets.token_urlsafe(18))
        self._hosts = {'localhost', *(h.lower() for h in hosts if h)}
        if not loopback:
            name = socket.gethostname().lower()
            self._hosts |= {name, f'{name}.local'}
        self._origins = {o.lower().rstrip('/') for o in origins if o}

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Why a request with these headers is refused; empty if it is not."""
        host = headers.get('Host', '').lower()
        name = host[1:].split(']', 1)[0] if host.startswith('[') else host
        if host.count(':') == 1:
            name = host.rsplit(':', 1)[0]
        if not (_address(name) or name in self._hosts):
            return f'Host {name[:100]!r} is not a name of this server'
        origin = headers.get('Origin', '').lower().rstrip('/')
        if origin and origin not in {f'http://{host}', f'https://{host}', *self._origins}:
            return f"Origin {origin[:100]!r} is not this server's"
        # A link from elsewhere may open the page; nothing else may be fetched from elsewhere.
        elsewhere = headers.get('Sec-Fetch-Site', 'none') in ('cross-site', 'same-site')
        if not origin and elsewhere and headers.get('Sec-Fetch-Mode') != 'navigate':
            return 'a request from another site'
        return ''

    def accepts(self, token: str) -> bool:
        """Whether a client's token is right, or none is needed; in the same time for all."""
        given = token.encode('utf-8', 'backslashreplace')
        return not self.token or hmac.compare_digest(given, self.token.encode())


def _address(name: str) -> Any:
    """IP address; None for another name."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(name)
