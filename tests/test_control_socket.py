"""The operator's socket: private, bounded, and harmless to the flight."""

import asyncio
import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.control_socket import (
    MAX_ANSWER_BYTES,
    MAX_CONNECTIONS,
    MAX_REQUEST_BYTES,
    ControlSocket,
    JsonObject,
    NotRunningError,
    ask,
)
from companion.errors import ProtocolError, StartError


def echo(request: JsonObject) -> JsonObject:
    return {"ok": True, "heard": request}


def served(
    path: Path, on_request: Callable[[JsonObject], JsonObject], client: Callable[[], object]
) -> tuple[object, ControlSocket]:
    """Run a blocking client in a thread against a real server."""

    async def scene() -> tuple[object, ControlSocket]:
        async with ControlSocket(path, on_request) as server:
            result = await asyncio.wait_for(asyncio.to_thread(client), 30.0)
        return result, server

    return asyncio.run(scene())


def raw(path: Path, payload: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(10.0)
        connection.connect(str(path))
        connection.sendall(payload)
        received = b""
        while part := connection.recv(65_536):
            received += part
        return received


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "control.sock"


@pytest.mark.parametrize("verb", ["engage", "release", "status"])
def test_a_request_reaches_the_handler_and_comes_back(path: Path, verb: str) -> None:
    answer, _ = served(path, echo, lambda: ask(path, {"verb": verb, "n": 1}))
    assert answer == {"ok": True, "heard": {"verb": verb, "n": 1}}
    assert not path.exists()


def test_the_socket_is_private_and_replaces_a_stale_one(path: Path) -> None:
    path.write_text("left by a dead process")
    mode, _ = served(path, echo, lambda: path.stat().st_mode & 0o777)
    assert mode == 0o600


@pytest.mark.parametrize(
    "payload",
    [
        b"\n",
        b"{\n",
        b"[]\n",
        b"3\n",
        b'{"verb": "fly"}\n',
        b'{"verb": ["engage"]}\n',
        b"\xff\xfe\n",
        b"[" * 4000 + b"\n",
    ],
)
def test_a_wrong_request_is_answered_counted_and_never_handled(path: Path, payload: bytes) -> None:
    handled: list[JsonObject] = []

    def on_request(request: JsonObject) -> JsonObject:
        handled.append(request)
        return {"ok": True}

    received, server = served(path, on_request, lambda: raw(path, payload))
    assert isinstance(received, bytes)
    assert json.loads(received)["ok"] is False
    assert handled == []
    assert server.refused == 1


def test_a_request_without_end_is_cut_off_at_the_limit(path: Path) -> None:
    def client() -> tuple[bytes, JsonObject]:
        try:
            received = raw(path, b"x" * (8 * MAX_REQUEST_BYTES))
        except OSError:
            received = b""
        return received, ask(path, {"verb": "status"})

    result, _ = served(path, echo, client)
    assert isinstance(result, tuple)
    assert b"true" not in result[0]
    assert result[1]["ok"] is True


def test_a_handler_that_fails_costs_one_answer_and_nothing_else(path: Path) -> None:
    def on_request(request: JsonObject) -> JsonObject:
        if request["verb"] == "engage":
            raise ZeroDivisionError
        return {"ok": True}

    def client() -> tuple[JsonObject, JsonObject]:
        return ask(path, {"verb": "engage"}), ask(path, {"verb": "status"})

    answers, _ = served(path, on_request, client)
    assert answers == ({"ok": False, "error": "internal error, see the log"}, {"ok": True})


def test_an_answer_that_is_too_long_or_not_json_is_replaced(path: Path) -> None:
    def on_request(request: JsonObject) -> JsonObject:
        return {"text": "x" * MAX_ANSWER_BYTES} if request["verb"] == "status" else {"object": object()}

    def client() -> list[JsonObject]:
        return [ask(path, {"verb": verb}) for verb in ("status", "engage")]

    answers, _ = served(path, on_request, client)
    assert answers == [
        {"ok": False, "error": "the answer is too long"},
        {"ok": False, "error": "internal error, see the log"},
    ]


def test_more_connections_than_allowed_are_closed_at_once(path: Path) -> None:
    def client() -> bytes:
        idle = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(MAX_CONNECTIONS)]
        try:
            for connection in idle:
                connection.settimeout(10.0)
                connection.connect(str(path))
            return raw(path, b"")
        finally:
            for connection in idle:
                connection.close()

    received, server = served(path, echo, client)
    assert received == b""
    assert server.refused >= 1


def test_nobody_listening_is_its_own_error(path: Path) -> None:
    with pytest.raises(NotRunningError, match="no companion answers"):
        ask(path, {"verb": "status"})


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"", NotRunningError),
        (b"[1]\n", ProtocolError),
        (b"{\n", ProtocolError),
        (b"x" * 70_000, ProtocolError),
    ],
)
def test_a_server_that_answers_nonsense_is_an_error_of_the_protocol(
    path: Path, reply: bytes, error: type[Exception]
) -> None:
    async def scene() -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readline()
            writer.write(reply)
            writer.close()

        async with await asyncio.start_unix_server(serve, path=str(path)):
            await asyncio.to_thread(ask, path, {"verb": "status"})

    with pytest.raises(error):
        asyncio.run(scene())


def test_a_path_too_long_for_a_socket_is_refused_before_binding(tmp_path: Path) -> None:
    with pytest.raises(StartError, match="longer than 107 bytes"):
        asyncio.run(ControlSocket(tmp_path / ("x" * 120), echo).start())


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(StartError, match="cannot bind"):
        asyncio.run(ControlSocket(tmp_path / "gone" / "c.sock", echo).start())
