"""The labeling server: one viser server, and one `Tab` per browser tab that was let in."""

from __future__ import annotations

import hmac
import logging
import threading
import time
from typing import cast

import viser

from codediffuser.labeling.gui.access import LOCAL_HOST, check_access
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.panels import ask_token
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.tab import Tab
from codediffuser.labeling.leases import LEASE_S

logger = logging.getLogger(__name__)

WRONG_TOKEN_S = 1.0
"""How long a wrong token is thought about, so that trying many takes long."""


class LocalServer(viser.ViserServer):
    """A viser server that no client can open to the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: viser would open a public tunnel for whoever asks."""
        logger.warning("a client asked for a public share link; refused")
        return None


class LabelApp:
    """Serves the labeling window.

    Args:
        desk: The run.
        operator: Proposed name of the operator.
        host: Address to listen at. Any but the own machine requires a token.
        port: Port; 0 takes a free one.
        token: What operators must enter; None lets everybody in who reaches the address.

    Raises:
        ConfigError: Another host without a token, or a token that is too short.
    """

    def __init__(
        self,
        desk: Desk,
        *,
        operator: str,
        host: str = LOCAL_HOST,
        port: int = 8080,
        token: str | None = None,
    ) -> None:
        check_access(host, token)
        self.desk, self._operator, self._token = desk, operator, token
        self.server = LocalServer(host=host, port=port, label="codediffuser", verbose=False)
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(230, 90, 0)
        )
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(430)
        self.tabs: dict[int, Tab] = {}
        self.server.on_client_connect(self._connect)
        self.server.on_client_disconnect(self._disconnect)
        self._closing = threading.Event()
        threading.Thread(target=self._renew_leases, daemon=True).start()

    @property
    def url(self) -> str:
        """Where to point the browser."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving; everything is on disk already."""
        self._closing.set()
        while self.tabs:
            # Taken out first: the server's end disconnects every tab once more.
            _, tab = self.tabs.popitem()
            tab.close()
        self.server.stop()
        self.desk.close()

    def _connect(self, client: viser.ClientHandle) -> None:
        name = _stored(client, "operator") or self._operator
        if self._token is None:
            self._admit(client, name)
            return

        def answer(token: str, operator: str) -> bool:
            right = hmac.compare_digest(token.encode(), cast(str, self._token).encode())
            if not right:
                time.sleep(WRONG_TOKEN_S)
            if not right or not operator.strip():
                return False
            client.local_storage.set_item("operator", operator.strip())
            self._admit(client, operator)
            return True

        ask_token(client, answer, name)

    def _admit(self, client: viser.ClientHandle, operator: str) -> None:
        self.tabs[client.client_id] = Tab(client, Session(self.desk, operator))

    def _disconnect(self, client: viser.ClientHandle) -> None:
        tab = self.tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()

    def _renew_leases(self) -> None:
        while not self._closing.wait(LEASE_S / 3):
            for tab in list(self.tabs.values()):
                self.desk.leases.renew(tab.session.tab)


def _stored(client: viser.ClientHandle, key: str) -> str | None:
    """What the browser remembers under a key; None when it remembers nothing or does not answer."""
    try:
        return client.local_storage.get_item(key, timeout=2.0)
    except (RuntimeError, TimeoutError):
        return None
