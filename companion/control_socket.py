"""A private Unix socket by which an operator on the same computer engages, releases and looks.

One request and one answer per connection, each a single JSON object on a line. The socket belongs to the
user who flies (mode 0600), the peer's user is checked as well, and both directions are bounded.
"""

import asyncio
import json
import os
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import structlog

from companion.errors import CompanionError, ProtocolError, StartError

MAX_REQUEST_BYTES = 4096
MAX_ANSWER_BYTES = 64 * 1024
MAX_CONNECTIONS = 4
MAX_PATH_BYTES = 107
REQUEST_TIMEOUT_S = 2.0
VERBS = ("engage", "release", "status")

JsonObject = dict[str, object]
_PEER_CREDENTIALS = struct.Struct("3i")

_log = structlog.get_logger(__name__)


class NotRunningError(CompanionError):
    """No companion answers on the control socket."""


class ControlSocket:
    """The server's side, on the event loop that also flies: handlers must return at once."""

    def __init__(self, path: Path, on_request: Callable[[JsonObject], JsonObject]) -> None:
        """Prepare.

        Args:
            path: where the socket appears; the folder must exist and be private.
            on_request: answers one request, whose ``verb`` is one of `VERBS`.
        """
        self._path = path
        self._on_request = on_request
        self._server: asyncio.AbstractServer | None = None
        self._open = 0
        self.refused = 0

    async def start(self) -> None:
        """Bind and listen; a socket file left by a dead process is replaced.

        Raises:
            StartError: if the socket cannot be bound.
        """
        if len(os.fsencode(self._path)) > MAX_PATH_BYTES:
            raise StartError(f"control socket: {self._path} is longer than {MAX_PATH_BYTES} bytes")
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._path.unlink(missing_ok=True)
            listener.bind(str(self._path))
            # Before listen() nobody can connect, so nobody can slip in before the mode is set.
            self._path.chmod(0o600)
            listener.setblocking(False)
            self._server = await asyncio.start_unix_server(
                self._serve, sock=listener, limit=MAX_REQUEST_BYTES, backlog=MAX_CONNECTIONS
            )
        except OSError as error:
            listener.close()
            raise StartError(f"control socket: cannot bind {self._path}: {error.strerror}") from None

    async def close(self) -> None:
        """Stop listening and remove the socket file."""
        if self._server is not None:
            self._server.close()
            self._server = None
            self._path.unlink(missing_ok=True)

    async def __aenter__(self) -> "ControlSocket":
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            if self._open <= MAX_CONNECTIONS and _trusted(writer):
                writer.write(await self._answer(reader))
                await asyncio.wait_for(writer.drain(), REQUEST_TIMEOUT_S)
            else:
                self.refused += 1
        except (OSError, asyncio.TimeoutError):
            self.refused += 1
        finally:
            self._open -= 1
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader) -> bytes:
        """Read one request and answer it; a wrong request gets an answer too."""
        try:
            line = await asyncio.wait_for(reader.readline(), REQUEST_TIMEOUT_S)
            request = json.loads(line)
        except (ValueError, RecursionError):
            return self._refuse("the request is not one line of JSON")
        verb = request.get("verb") if isinstance(request, dict) else None
        if verb not in VERBS:
            return self._refuse(f"the verb is not one of {', '.join(VERBS)}")
        try:
            return _line(self._on_request(request))
        except Exception:
            # A request from the ground must never end a flight.
            _log.exception("control request failed", verb=verb)
            return self._refuse("internal error, see the log")

    def _refuse(self, reason: str) -> bytes:
        self.refused += 1
        return _line({"ok": False, "error": reason})


def ask(path: Path, request: JsonObject, timeout_s: float = 3.0) -> JsonObject:
    """Send one request to a running companion and return its answer.

    Raises:
        NotRunningError: if nobody answers in time.
        ProtocolError: if the answer is not one JSON object.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC) as connection:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            connection.sendall(_line(request))
            received = bytearray()
            while not received.endswith(b"\n") and (part := connection.recv(65_536)):
                received += part
                if len(received) > MAX_ANSWER_BYTES:
                    raise ProtocolError(f"the answer on {path} is longer than {MAX_ANSWER_BYTES} bytes")
    except OSError as error:
        reason = error.strerror or "no answer"
        raise NotRunningError(f"no companion answers on {path}: {reason}") from None
    if not received:
        raise NotRunningError(f"the companion on {path} refused the connection")
    try:
        answer = json.loads(received)
    except (ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict):
        raise ProtocolError(f"the answer on {path} is not a JSON object")
    return answer


def _line(message: JsonObject) -> bytes:
    line = json.dumps(message).encode("ascii") + b"\n"
    if len(line) > MAX_ANSWER_BYTES:
        return json.dumps({"ok": False, "error": "the answer is too long"}).encode("ascii") + b"\n"
    return line


def _trusted(writer: asyncio.StreamWriter) -> bool:
    """Tell whether the peer runs as this user or as root."""
    connection: socket.socket = writer.get_extra_info("socket")
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
    _, user, _ = _PEER_CREDENTIALS.unpack(raw)
    return user in (0, os.getuid())
