# SPDX-License-Identifier: Apache-2.0
"""The server of the console without ROS: its port, its token, and browsers that are slow."""

import asyncio
import itertools
import threading

import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from fiber_console import ConsoleError, ConsoleServer, PlaneFeed, kept_token


def serve(folder, visit, order=lambda *_: "done"):
    async def run():
        server = ConsoleServer(PlaneFeed(), order, "token", folder, 0)
        try:
            return await visit(server)
        finally:
            server.close()

    return asyncio.run(run())


async def browser(server):
    headers = {"Origin": f"http://127.0.0.1:{server.port}"}
    address = f"ws://127.0.0.1:{server.port}/live?token={server.token}"
    return await websocket_connect(HTTPRequest(address, headers=headers))


def test_a_port_that_is_taken_is_named(tmp_path):
    async def visit(server):
        with pytest.raises(ConsoleError, match=f"port {server.port} of 127.0.0.1 cannot be used"):
            ConsoleServer(PlaneFeed(), lambda *_: "", "token", tmp_path, server.port)

    serve(tmp_path, visit)


def test_a_token_is_kept_for_its_owner_alone(tmp_path):
    file = tmp_path / "logs/token"
    token = kept_token(file)
    assert kept_token(file) == token and len(token) >= 32
    assert file.stat().st_mode & 0o077 == 0
    file.write_text("")
    with pytest.raises(ConsoleError, match="is empty"):
        kept_token(file)
    with pytest.raises(ConsoleError, match="cannot be kept"):
        kept_token(file / "below")
    file.write_text("known")
    file.chmod(0o640)
    with pytest.raises(ConsoleError, match="open to other users"):
        kept_token(file)


def test_a_browser_that_does_not_read_gets_the_newest_motion_and_delays_no_other(tmp_path):
    pictures = 400

    async def visit(server):
        slow, quick = await browser(server), await browser(server)
        seen = 0
        for number in range(pictures):
            server.send_motion(number.to_bytes(4, "little") * 50_000)
            while True:
                message = await quick.read_message()
                if isinstance(message, bytes):
                    break
            seen += int.from_bytes(message[:4], "little") == number
        behind = [client for client in server.clients if not client.sending.done()]
        newest, read = -1, 0
        while newest < pictures - 1:  # what it was sent before, and then the newest
            message = await asyncio.wait_for(slow.read_message(), 20.0)
            if isinstance(message, bytes):
                newest, read = int.from_bytes(message[:4], "little"), read + 1
        slow.close()
        return seen, len(behind), read

    seen, behind, read = serve(tmp_path, visit)
    assert seen == pictures and behind == 1 and read < pictures


def test_orders_that_hang_delay_no_stop(tmp_path):
    hanging = 40

    async def visit(server):
        socket = await browser(server)
        for number in range(hanging):
            await socket.write_message(f'{{"number": {number}, "order": "home"}}')
        for number in (98, 99):
            await socket.write_message(f'{{"number": {number}, "order": "stop"}}')
        answers = []
        while len(answers) < hanging + 2:
            message = await socket.read_message()
            if '"answer"' in message:
                answers.append(message)
                released.set()
        return answers

    released, stops = threading.Event(), itertools.count()

    def order(name, *_):
        if name == "home" or next(stops) == 0:  # the first stop hangs as well
            assert released.wait(20)
        return name

    first, *others = serve(tmp_path, visit, order)
    assert '"order": "stop"' in first and len(others) == hanging + 1
