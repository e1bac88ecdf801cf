"""Who may reach the labeling window."""

from __future__ import annotations

from codediffuser.errors import ConfigError

LOCAL_HOST = "127.0.0.1"
MIN_TOKEN = 8


def check_access(host: str, token: str | None) -> None:
    """Refuse to serve other machines without a token.

    Raises:
        ConfigError: The message says what to add.
    """
    if host not in (LOCAL_HOST, "localhost", "::1") and token is None:
        raise ConfigError(
            f"--host {host} lets other machines in, so a token is required: set the environment "
            "variable CODEDIFFUSER_LABEL_TOKEN, or keep to this machine and use an ssh tunnel"
        )
    if token is not None and len(token) < MIN_TOKEN:
        raise ConfigError(f"the token has {len(token)} characters, expected at least {MIN_TOKEN}")
