# SPDX-License-Identifier: Apache-2.0
"""Serves the console over HTTP and WebSocket on loopback, to browsers that know its token."""

import asyncio
import json
import os
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketHandler

from fiber_console.errors import ConsoleError
from fiber_console.plane_feed import PlaneFeed
from fiber_core.threads import started_pool
from fiber_viewer.page import console_page, write_player

__all__ = ["ConsoleServer", "Order", "kept_token"]

_ADDRESS = "127.0.0.1"
_STATUS_PERIOD_S = 0.1  # least time between two messages about stages, alerts and buses
_PLANS_PERIOD_S = 2.0  # time between two looks at the folder of the recordings
_PLANS_SHOWN = 20
_TOKEN_BYTES = 24
_STOPS, _ORDERS = 32, 4  # orders that may wait for an answer at once

# an order from a browser: its name, the plan, ids of robots, why; returns the answer's text
Order = Callable[[str, str | None, Sequence[int], str], str]


def kept_token(path: Path) -> str:
    """Return the token in a file that only its owner may read; a missing file is made.

    A token that outlives the process lets pages that are open go on after a restart.

    Args:
        path: the file.

    Raises:
        ConsoleError: the file cannot be read or written, or others could have read or made it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            _make_token(path)
        with open(path) as file:
            about = os.fstat(file.fileno())
            token = file.read().strip()
    except OSError as error:
        raise ConsoleError(f"the token of the console cannot be kept: {error}") from None
    if about.st_uid != os.geteuid() or about.st_mode & 0o077:
        raise ConsoleError(f"{path} is open to other users, or theirs: remove it")
    if not token:
        raise ConsoleError(f"the token in {path} is empty: remove the file")
    return token


def _make_token(path: Path) -> None:
    # as a whole: of two consoles that start together both take the token of the first
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(secrets.token_urlsafe(_TOKEN_BYTES))
    try:
        os.link(fresh, path)
    except FileExistsError:
        pass
    finally:
        fresh.unlink()


class ConsoleServer:
    """Sends what a feed knows to all browsers, and passes their orders on.

    It belongs to the loop of asyncio that runs when it is made; only `send_motion` and `touch` may
    be called from other threads. A browser that is slow misses motions, and delays nothing else.

    Args:
        feed: what is shown.
        order: carries out an order; called in a thread, it may wait; an exception of it is the
            answer.
        token: every request has it as ``?token=``.
        folder: folder of the recordings.
        port: port on loopback; 0 for any that is free.

    Raises:
        ConsoleError: the port is taken.
    """

    def __init__(self, feed: PlaneFeed, order: Order, token: str, folder: Path, port: int):
        self.feed, self.order, self.token, self.folder = feed, order, token, folder
        self.clients: set[_Live] = set()
        self.plans: list[str] = []
        self._loop = asyncio.get_running_loop()
        self._motion: bytes | None = None
        self._told = asyncio.Event()
        # a stop is carried out whatever other orders, and earlier stops, wait for
        self._stops, self._orders = started_pool(_STOPS), ThreadPoolExecutor(_ORDERS)
        application = Application(
            [
                ("/", _Page),
                ("/plane.npz", _Plane),
                (r"/plans/(plan-[0-9.]+)\.html", _Plan),
                ("/live", _Live),
            ],
            server=self,
            websocket_ping_interval=10.0,
        )
        try:
            sockets = bind_sockets(port, _ADDRESS)
        except OSError as error:
            raise ConsoleError(
                f"port {port} of {_ADDRESS} cannot be used: {error.strerror}: choose another port"
            ) from None
        self.port = int(sockets[0].getsockname()[1])
        self._http = HTTPServer(application)
        self._http.add_sockets(sockets)
        self._tasks = [
            asyncio.ensure_future(self._tell()),
            asyncio.ensure_future(self._look_for_plans()),
        ]

    @property
    def address(self) -> str:
        """The address of the page, with the token."""
        return f"http://{_ADDRESS}:{self.port}/?token={self.token}"

    @property
    def hosts(self) -> set[str]:
        """Names under which a browser on this machine reaches the server."""
        return {f"{_ADDRESS}:{self.port}", f"localhost:{self.port}"}

    def send_motion(self, message: bytes) -> None:
        """Send joint angles to all browsers; from any thread."""
        self._loop.call_soon_threadsafe(self._send_motion, message)

    def touch(self) -> None:
        """Send the status soon, as it has changed; from any thread."""
        self._loop.call_soon_threadsafe(self._told.set)

    def close(self) -> None:
        """Leave all browsers alone."""
        for task in self._tasks:
            task.cancel()
        for pool in (self._stops, self._orders):
            pool.shutdown(wait=False, cancel_futures=True)
        self._http.stop()
        for client in list(self.clients):
            client.close()

    async def carry_out(self, order: str, plan: str | None, ids: Sequence[int], why: str) -> str:
        """Carry out an order in a thread; stops have threads of their own."""
        pool = self._stops if order == "stop" else self._orders
        return await self._loop.run_in_executor(pool, self.order, order, plan, ids, why)

    def newest_motion(self) -> bytes | None:
        """Return the joint angles that were sent last."""
        return self._motion

    def status(self) -> str:
        """Return the status as JSON."""
        return json.dumps(self.feed.status() | {"plans": self.plans})

    def _send_motion(self, message: bytes) -> None:
        self._motion = message
        for client in self.clients:
            client.send_motion(message)

    async def _tell(self) -> None:
        while True:
            await self._told.wait()
            self._told.clear()
            text = self.status()
            for client in list(self.clients):
                client.tell(text)
            await asyncio.sleep(_STATUS_PERIOD_S)

    async def _look_for_plans(self) -> None:
        while True:
            names = sorted((path.stem for path in self.folder.glob("plan-*.npz")), reverse=True)
            if names[:_PLANS_SHOWN] != self.plans:
                self.plans = names[:_PLANS_SHOWN]
                self._told.set()
            await asyncio.sleep(_PLANS_PERIOD_S)


class _Guarded(RequestHandler):
    """Answers requests of this machine that have the token."""

    @property
    def server(self) -> ConsoleServer:
        return self.settings["server"]

    def prepare(self) -> None:
        # a name that is not loopback's comes from a page whose name was bound to this address
        if self.request.host not in self.server.hosts:
            raise HTTPError(403, "the console answers on loopback only")
        given = self.get_query_argument("token", "")
        if not secrets.compare_digest(given.encode(), self.server.token.encode()):
            raise HTTPError(403, "the token is missing or wrong")

    def set_default_headers(self) -> None:
        self.set_header("X-Frame-Options", "DENY")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cache-Control", "no-store")

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        error = kwargs.get("exc_info", (None, None))[1]
        text = getattr(error, "log_message", None) or self._reason
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {text}\n")


class _Page(_Guarded):
    def get(self) -> None:
        self.finish(console_page())


class _Plane(_Guarded):
    async def get(self) -> None:
        content = await asyncio.to_thread(self.server.feed.plane_file)
        if content is None:
            raise HTTPError(404, "no layout was received yet")
        self.set_header("Content-Type", "application/octet-stream")
        self.finish(content)


class _Plan(_Guarded):
    async def get(self, name: str) -> None:
        recording = self.server.folder / f"{name}.npz"
        if not recording.is_file():
            raise HTTPError(404, f"there is no recording {name}")
        page = self.server.folder / f"{name}.html"
        if not page.is_file():
            await asyncio.to_thread(write_player, page, recording)
        self.finish(await asyncio.to_thread(page.read_bytes))


class _Live(WebSocketHandler, _Guarded):
    """One browser: it is told what happens, and sends orders."""

    def check_origin(self, origin: str) -> bool:
        return urlsplit(origin).netloc in self.server.hosts

    def open(self, *_: str, **__: str) -> None:
        self.set_nodelay(True)
        self.sending: asyncio.Future[None] | None = None
        self._behind = False
        self._orders: set[asyncio.Future[None]] = set()
        self.server.clients.add(self)
        self.tell(self.server.status())
        motion = self.server.newest_motion()
        if motion is not None:
            self.send_motion(motion)

    def on_close(self) -> None:
        self.server.clients.discard(self)

    def send_motion(self, message: bytes) -> None:
        self._behind = self.sending is not None and not self.sending.done()
        if not self._behind:
            self.sending = self._send(message)
            self.sending.add_done_callback(self._catch_up)

    def _catch_up(self, _: object) -> None:
        motion = self.server.newest_motion()
        if self._behind and motion is not None:
            self.send_motion(motion)

    def tell(self, text: str) -> None:
        self._orders.add(self._send(text))
        self._orders = {each for each in self._orders if not each.done()}

    def _send(self, message: str | bytes) -> "asyncio.Future[None]":
        async def send() -> None:
            try:
                await self.write_message(message, binary=isinstance(message, bytes))
            except Exception:
                self.server.clients.discard(self)  # the browser has gone

        return asyncio.ensure_future(send())

    def on_message(self, message: str | bytes) -> None:
        self._orders.add(asyncio.ensure_future(self._carry_out(message)))

    async def _carry_out(self, message: str | bytes) -> None:
        """Pass an order on, and send its answer."""
        answer: dict[str, object] = {"kind": "answer", "number": -1, "ok": False}
        try:
            wanted = json.loads(message)
            answer |= {"number": wanted["number"], "order": wanted["order"]}
            ids = [int(robot) for robot in wanted.get("ids", [])]
            plan, why = wanted.get("plan"), str(wanted.get("why", ""))
            text = await self.server.carry_out(str(wanted["order"]), plan, ids, why)
            answer |= {"ok": True, "text": text}
        except Exception as error:  # whatever a browser sends, it is told why that was refused
            answer |= {"text": str(error) or type(error).__name__}
        self.tell(json.dumps(answer))
