"""Who may see the page, and who may press its buttons."""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterable, Mapping

from lpv_core.support.errors import ConfigError

_SHORTEST_TOKEN = 16


class Access:
    """Decides on requests by their headers, and on commands by their token.

    A page of another site that the operator happens to have open can make the browser send
    requests here: its ``Origin`` gives it away.  With DNS rebinding the other site's own name
    points here; then ``Host`` is that name.  Addresses cannot be rebound, so they are accepted.

    Parameters
    ----------
    address : str
        Where the server listens.
    token : str, optional
        Asked for before commands; empty: none on the loopback address, a random one elsewhere.
    hosts : iterable of str, optional
        Names beside addresses, ``localhost`` and this machine's, under which it may be called.
    origins : iterable of str, optional
        Origins beside the page's own that may connect, e.g. ``https://app.foxglove.dev``.

    Attributes
    ----------
    token : str
        The token that commands need; empty if they need none.
    loopback : bool
        Whether only this machine can connect.

    Raises
    ------
    ConfigError
        If the address is none, or the token is too short.
    """

    def __init__(
        self, address: str, token: str = '', hosts: Iterable[str] = (), origins: Iterable[str] = ()
    ) -> None:
        self.loopback = is_loopback(address)
        if token and len(token) < _SHORTEST_TOKEN:
            raise ConfigError('token', f'must have at least {_SHORTEST_TOKEN} characters')
        self.token = token or ('' if self.loopback else secrets.token_urlsafe(18))
        self._hosts = {'localhost', *(h.lower() for h in hosts if h)}
        if not self.loopback:
            name = socket.gethostname().lower()
            self._hosts |= {name, f'{name}.local'}
        self._origins = {o.lower().rstrip('/') for o in origins if o}

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Why a request with these headers is refused; empty if it is not."""
        host = headers.get('Host', '')
        name = _host_name(host)
        if not (_is_address(name) or name in self._hosts):
            return f'Host {name[:100]!r} is not a name of this server'
        origin = headers.get('Origin', '').lower().rstrip('/')
        own = (f'http://{host.lower()}', f'https://{host.lower()}')
        if origin and origin not in own and origin not in self._origins:
            return f"Origin {origin[:100]!r} is not this server's"
        # A link from elsewhere may open the page; nothing else may be fetched from elsewhere.
        if (
            not origin
            and headers.get('Sec-Fetch-Site', 'none') in ('cross-site', 'same-site')
            and headers.get('Sec-Fetch-Mode') != 'navigate'
        ):
            return 'a request from another site'
        return ''

    def accepts(self, token: str) -> bool:
        """Whether a client's token is right, or none is needed; in the same time for all."""
        return not self.token or hmac.compare_digest(
            token.encode('utf-8', 'backslashreplace'), self.token.encode()
        )


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach an IP address or ``localhost``.

    Raises ConfigError if it is neither.
    """
    if address == 'localhost':
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        raise ConfigError(
            'address',
            f'{address!r} must be localhost or an IP address; 0.0.0.0 '
            'stands for all of this machine',
        ) from None


def _host_name(host: str) -> str:
    """Name of a Host header, without its port and brackets."""
    if host.startswith('['):
        return host[1:].split(']', 1)[0].lower()
    return host.rsplit(':', 1)[0].lower() if host.count(':') == 1 else host.lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
