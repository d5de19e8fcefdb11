# SPDX-License-Identifier: Apache-2.0
"""What follows a console in a measurement: a client of its WebSocket alone, and Chromium."""

import asyncio
import json
import threading
import time
from pathlib import Path
from typing import Protocol

from headless_chromium import start_chromium
from selenium.webdriver.support.ui import WebDriverWait
from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

__all__ = ["ChromiumFollower", "Follower", "SocketFollower"]

_WAIT_S = 300.0
_MOST_BYTES = 10_000_000  # of one message
_SIZE = 1440, 1000
# times of motions that the page was sent, and of pictures that it drew [s since 1970]
_COUNT = """
const {connection} = player, {motion} = connection.on, frame = player.frame.bind(player);
const now = () => (performance.timeOrigin + performance.now()) / 1000;
globalThis.seen = {motions: [], pictures: []};
connection.on.motion = (...given) => { seen.motions.push(now()); motion(...given); };
player.frame = () => {
  const before = player.frames;
  frame();
  if (player.frames > before) seen.pictures.push(now());
};
"""
_STOP = """
const done = arguments[0], {orders} = player, answered = orders.answered.bind(orders);
orders.answered = (message) => {
  answered(message);
  if (message.order !== "stop") return;
  orders.answered = answered;
  done(performance.now() - began);
};
const began = performance.now();
document.querySelector("#orders [data-order=stop]").click();
"""


class Follower(Protocol):
    """Follows a console."""

    def motions_s(self) -> list[float]:
        """Return when motions were received [s since 1970]."""
        ...

    def pictures_s(self) -> list[float]:
        """Return when pictures were drawn [s since 1970]."""
        ...

    def stop_s(self) -> float:
        """Order a stop; return the time to its answer [s]."""
        ...

    def close(self) -> None:
        """Leave the console."""
        ...


class SocketFollower:
    """Takes what a console sends, in a thread, and draws nothing.

    Args:
        address: the address that the console printed.
    """

    def __init__(self, address: str):
        self._motions_s: list[float] = []
        self._answers: dict[int, threading.Event] = {}
        self._loop = asyncio.new_event_loop()
        self._socket: WebSocketClientConnection | None = None
        base, _, query = address.partition("/?")
        self._request = HTTPRequest(
            f"{base.replace('http', 'ws')}/live?{query}", headers={"Origin": base}
        )
        threading.Thread(target=self._loop.run_until_complete, args=(self._follow(),)).start()

    def motions_s(self) -> list[float]:
        """Return when motions were received [s since 1970]."""
        return list(self._motions_s)

    def pictures_s(self) -> list[float]:
        """Return nothing: none is drawn."""
        return []

    def stop_s(self) -> float:
        """Order a stop; return the time to its answer [s]."""
        number = len(self._answers)
        answered = self._answers[number] = threading.Event()
        begin = time.perf_counter()
        self._loop.call_soon_threadsafe(self._send, {"number": number, "order": "stop"})
        if not answered.wait(_WAIT_S):
            raise TimeoutError("no answer to stop")
        return time.perf_counter() - begin

    def close(self) -> None:
        """Leave the console."""
        if self._socket is not None:
            self._loop.call_soon_threadsafe(self._socket.close)

    def _send(self, message: dict[str, object]) -> None:
        if self._socket is not None:
            self._socket.write_message(json.dumps(message))

    async def _follow(self) -> None:
        self._socket = await websocket_connect(self._request, max_message_size=_MOST_BYTES)
        while (message := await self._socket.read_message()) is not None:
            if isinstance(message, bytes):
                self._motions_s.append(time.time())
            elif (answer := json.loads(message))["kind"] == "answer":
                self._answers[answer["number"]].set()


class ChromiumFollower:
    """Has the page of a console open, without a screen.

    Args:
        address: the address that the console printed.
        profile: folder of the browser's profile.
    """

    def __init__(self, address: str, profile: Path):
        self._driver = start_chromium(profile, _SIZE)
        self._driver.set_script_timeout(_WAIT_S)
        self._driver.get(address)
        WebDriverWait(self._driver, _WAIT_S).until(
            lambda driver: driver.execute_script("return globalThis.player?.frames > 0")
        )
        self._driver.execute_script(_COUNT)

    def motions_s(self) -> list[float]:
        """Return when motions were received [s since 1970]."""
        return self._driver.execute_script("return seen.motions")

    def pictures_s(self) -> list[float]:
        """Return when pictures were drawn [s since 1970]."""
        return self._driver.execute_script("return seen.pictures")

    def stop_s(self) -> float:
        """Click on stop; return the time to its answer in the page [s]."""
        return 1e-3 * self._driver.execute_async_script(_STOP)

    def close(self) -> None:
        """End the browser."""
        self._driver.quit()
