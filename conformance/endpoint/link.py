"""A link to a switch over UDP: handshake, hello, requests and frames (`docs/wire-format/links.md`)."""

import asyncio
import secrets
import socket
import time
from collections.abc import Awaitable, Callable

from aioquic.quic import events

from . import frames
from .certificates import boolean, number, or_null, record
from .control import MAX_MESSAGE, frame, listed, parse_request, parse_response, refusal
from .encoding import Refused, compressed, decode, derive_name, is_bytes
from .rawkeys import SPOKEN, RawKeyConnection

HELLO_S = 5.0
REQUEST_S = 5.0
KEEP_ALIVE_S = 1.0
MAX_HELLO = 13312
MAX_FRAME = 1200
OWN_MTU = 8972
VERSION, MALFORMED, WRONG_PEER, TIMEOUT = 1, 2, 3, 4
BYTE = number(0, 255)
HELLO = {
    "role": lambda value: value in ("Endpoint", "Switch"),
    "digest": lambda value: is_bytes(value, 32),
    "link_id": number(1, 2**32 - 1),
    "lane": number(0, 3),
    "mtu": number(512, 65631),
    "zero_checksum": boolean,
    "host": or_null(number()),
    "frames_at": or_null(lambda value: listed(BYTE, 4)(value) and len(value) == 4),
    "run": or_null(number()),
    "papers": or_null(record(membership=lambda _: True, peers=lambda _: True)),
}


class LinkClosed(Exception):
    """The link has ended, with a code of the document and a text for people."""

    def __init__(self, code: int | None, reason: str):
        super().__init__(f"closed with code {code}: {reason}")
        self.code, self.reason = code, reason


class Link(asyncio.DatagramProtocol):
    """A link that this side dialled. Frames and requests go to the callbacks."""

    def __init__(self, key, digest: bytes, on_frame: Callable, on_request: Callable[..., Awaitable]):
        self.key, self.digest = key, digest
        self.on_frame, self.on_request = on_frame, on_request
        self.quic = RawKeyConnection(key)
        self.loop = asyncio.get_running_loop()
        self.streams: dict[int, bytearray] = {}
        self.answers: dict[int, asyncio.Future] = {}
        self.ready: asyncio.Future = self.loop.create_future()
        self.closed: asyncio.Future = self.loop.create_future()
        self.timer: asyncio.TimerHandle | None = None
        self.tasks: set[asyncio.Task] = set()
        self.own_id = secrets.randbelow(2**32 - 1) + 1
        self.run = time.time_ns()
        self.sent = 0
        # Every data frame of so many is lost on purpose, in each direction; 0 for none.
        self.lose, self.passed = 0, [0, 0]
        self.dropped: dict[str, int] = {}
        self.errors: dict[str, int] = {}
        self.echoes: dict[bytes, asyncio.Future] = {}
        self.receiver: frames.Receiver | None = None
        self.peer: bytes | None = None

    @classmethod
    async def dial(cls, host: str, port: int, *identity) -> "Link":
        """Returns a link after both hellos, or fails with `LinkClosed`."""
        link = cls(*identity)
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        carrier = socket.socket(family, socket.SOCK_DGRAM)
        carrier.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        carrier.bind(("", 0))
        link.address = address
        await link.loop.create_datagram_endpoint(lambda: link, sock=carrier)
        link.quic.connect(address, link.loop.time())
        link.flush()
        try:
            async with asyncio.timeout(HELLO_S):
                await asyncio.shield(link.ready)
        except TimeoutError as error:
            link.close(TIMEOUT, "no hello in time")
            raise LinkClosed(TIMEOUT, "no hello in time") from error
        link.start(link.keep_alive())
        return link

    # Datagrams and timers.

    def connection_made(self, transport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, address) -> None:
        # On a port that is shared with QUIC, a first byte below 0x40 marks a frame.
        if data and data[0] < 0x40:
            self.frame_received(data)
            return
        self.quic.receive_datagram(data, address, self.loop.time())
        self.flush()

    def flush(self) -> None:
        while (event := self.quic.next_event()) is not None:
            self.event(event)
        for data, address in self.quic.datagrams_to_send(self.loop.time()):
            self.transport.sendto(data, address)
        if self.timer is not None:
            self.timer.cancel()
        due = self.quic.get_timer()
        self.timer = None if due is None else self.loop.call_at(due, self.tick)

    def tick(self) -> None:
        self.timer = None
        self.quic.handle_timer(self.loop.time())
        self.flush()

    async def keep_alive(self) -> None:
        while True:
            await asyncio.sleep(KEEP_ALIVE_S)
            self.quic.send_ping(0)
            self.flush()

    def start(self, work) -> None:
        task = self.loop.create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    # The connection.

    def event(self, event) -> None:
        match event:
            case events.ProtocolNegotiated():
                if event.alpn_protocol != SPOKEN:
                    reason = f"{event.alpn_protocol} was chosen, this side speaks {SPOKEN}"
                    self.quic.close(VERSION, reason_phrase=reason)
            case events.HandshakeCompleted():
                stream = self.quic.get_next_available_stream_id()
                self.streams[stream] = bytearray()
                self.quic.send_stream_data(stream, frame(self.hello()), end_stream=True)
            case events.StreamDataReceived():
                self.stream_data(event.stream_id, event.data, event.end_stream)
            case events.StreamReset() if event.stream_id in self.answers:
                self.answers.pop(event.stream_id).set_exception(Refused("Unreachable", "the stream was reset"))
            case events.ConnectionTerminated():
                # Codes of the transport are no codes of the document.
                self.end(LinkClosed(event.error_code if event.frame_type is None else None, event.reason_phrase))

    def hello(self) -> dict:
        return {
            "role": "Endpoint", "digest": self.digest, "link_id": self.own_id, "lane": 0, "mtu": OWN_MTU,
            "zero_checksum": True, "host": None, "frames_at": None, "run": self.run, "papers": None,
        }

    def stream_data(self, stream: int, data: bytes, end: bool) -> None:
        buffer = self.streams.setdefault(stream, bytearray())
        buffer += data
        limit = MAX_HELLO if stream == 0 else MAX_MESSAGE
        if len(buffer) > 4 + limit:
            self.close(MALFORMED, "a message that is too long")
            return
        if len(buffer) < 4 + int.from_bytes(buffer[:4]) and not end:
            return
        if not end and stream & 3 != 0:
            return
        body = bytes(buffer[4:])
        if stream == 0:
            if self.receiver is None:
                self.greet(body)
        elif stream & 3 == 0:
            if end and stream in self.answers:
                self.answers.pop(stream).set_result(body)
        else:
            self.start(self.answer(stream, body))
        if end:
            self.streams.pop(stream, None)

    def greet(self, body: bytes) -> None:
        try:
            hello = decode(body)
            if not isinstance(hello, dict) or not all(f in hello and check(hello[f]) for f, check in HELLO.items()):
                raise Refused("Malformed", "the hello")
            if hello["frames_at"] is not None:
                raise Refused("Malformed", "an address for frames that was not asked for")
        except Refused as refused:
            self.close(MALFORMED, refused.reason)
            return
        if hello["role"] != "Switch":
            self.close(WRONG_PEER, "a switch was expected")
            return
        self.peer_id, self.mtu = hello["link_id"], min(hello["mtu"], MAX_FRAME)
        self.proof = {"owner_key": compressed(self.quic.tls.peer_key()), "digest": hello["digest"]}
        self.peer = derive_name(self.proof["owner_key"], hello["digest"])
        outward, inward = (
            frames.link_secrets(self.quic.tls.export(b"EXPORTER-gdp-link", direction, 32))
            for direction in (b"client to server", b"server to client")
        )
        self.send_key = next(outward)[1]
        self.inward, self.generation = inward, 0
        self.receiver = frames.Receiver(self.own_id, [next(inward)[1], next(inward)[1]])
        self.ready.set_result(None)

    def end(self, closed: LinkClosed) -> None:
        for waiting in (self.ready, *self.answers.values()):
            if not waiting.done():
                waiting.set_exception(closed)
        self.answers.clear()
        if not self.closed.done():
            self.closed.set_result(closed)
        for task in list(self.tasks):
            task.cancel()
        self.transport.close()

    def close(self, code: int = 0, reason: str = "") -> None:
        self.quic.close(code, reason_phrase=reason)
        self.flush()

    # Requests.

    async def request(self, message) -> tuple[str, object]:
        """Asks, and returns the answer. A refusal is raised."""
        stream = self.quic.get_next_available_stream_id()
        self.streams[stream] = bytearray()
        answer = self.answers[stream] = self.loop.create_future()
        self.quic.send_stream_data(stream, frame(message), end_stream=True)
        self.flush()
        try:
            async with asyncio.timeout(REQUEST_S):
                body = await answer
        except TimeoutError as error:
            self.answers.pop(stream, None)
            raise Refused("Unreachable", "no answer in time") from error
        title, data = parse_response(body)
        if title == "Refused":
            raise Refused(data["code"], data["reason"])
        return title, data

    async def answer(self, stream: int, body: bytes) -> None:
        try:
            title, data = parse_request(body)
            if title == "Ratcheted":
                response = await self.ratchet(data["generation"])
            else:
                response = await self.on_request(title, data)
        except Refused as refused:
            response = refusal(refused)
        self.quic.send_stream_data(stream, frame(response), end_stream=True)
        self.flush()

    async def ratchet(self, generation: int) -> str:
        """The peer uses another key from now on: the key before it is given up after 2 s."""
        if generation <= self.generation:
            return "Done"
        if generation != self.generation + 1:
            raise Refused("Malformed", "a generation that does not follow")
        await asyncio.sleep(2)
        self.receiver.keys[self.generation & 1] = next(self.inward)[1]
        self.generation = generation
        return "Done"

    # Frames.

    def send(self, destination: bytes, payload: bytes) -> None:
        source = derive_name(compressed(self.key.public_key()), self.digest)
        self.send_frame(frames.Frame(frames.DATA, destination, source, payload, flags=frames.ECT0))

    def is_lost(self, kind: int, direction: int) -> bool:
        self.passed[direction] += kind == frames.DATA
        return kind == frames.DATA and self.lose != 0 and self.passed[direction] % self.lose == 0

    def send_frame(self, sent: frames.Frame) -> None:
        self.sent += 1
        if self.is_lost(sent.kind, 0):
            return
        self.transport.sendto(sent.seal(self.send_key, self.peer_id, self.sent), self.address)

    def frame_received(self, data: bytes) -> None:
        if self.receiver is None:
            return
        try:
            received = self.receiver.open(data)
            if self.is_lost(received.kind, 1):
                return
            if received.kind == frames.DATA:
                self.on_frame(received)
            elif received.kind == frames.ERROR:
                reason = frames.error_of(received)[0]
                self.errors[reason] = self.errors.get(reason, 0) + 1
            elif received.kind == frames.ECHO:
                self.echo_received(received)
        except Refused as refused:
            self.dropped[refused.code] = self.dropped.get(refused.code, 0) + 1

    def echo_received(self, received: frames.Frame) -> None:
        if received.egress_set == 0:
            self.send_frame(frames.echo_answer(received))
        elif waiting := self.echoes.pop(received.egress_bits, None):
            waiting.set_result(None)

    async def echo(self, within: float = 1.0) -> None:
        """Asks the switch's data plane whether it is alive."""
        cookie = secrets.token_bytes(8)
        waiting = self.echoes[cookie] = self.loop.create_future()
        self.send_frame(frames.echo(cookie))
        async with asyncio.timeout(within):
            await waiting
