"""Sessions with asyncio, over the extension module."""

import asyncio
import atexit
import base64
import json
import os
import time
from dataclasses import dataclass
from typing import Any

from . import _gdp


class _Process:
    """Whether this process may use the extension, whose threads a fork does not copy."""

    def __init__(self):
        self.is_used = self.is_forked = False
        os.register_at_fork(after_in_child=self._forked)
        atexit.register(self._finish)

    def _forked(self):
        self.is_forked = self.is_used

    def _finish(self):
        if not self.is_forked:
            _gdp.finish()

    def use(self):
        if self.is_forked:
            raise _gdp.GdpError(
                "a session does not survive a fork; start processes with 'spawn', as"
                " multiprocessing.get_context('spawn') does, and open sessions in them"
            )
        self.is_used = True


_process = _Process()


class _Attaching:
    """A handle that attaches when it is awaited, entered with `async with`, or iterated."""

    def __init__(self, attach):
        self._attach = attach
        self._native = None
        self._attaching = asyncio.Lock()
        self._closed = False

    def __await__(self):
        return self._attached().__await__()

    async def _attached(self):
        _process.use()
        # One task attaches, and others wait for it.
        async with self._attaching:
            if self._closed:
                raise _gdp.GdpError("it is closed; make another one")
            if self._native is None:
                self._native = await self._attach()
        return self

    async def __aenter__(self):
        return await self._attached()

    async def __aexit__(self, *_):
        # The extension withdraws the name when its object ends.
        self._native, self._closed = None, True


class _Receiving(_Attaching):
    """A handle that receives, until the session is closed."""

    async def recv(self, timeout=None):
        """Return the next one, or None after the session is closed. Raises TimeoutError.

        A call that is cancelled or times out loses nothing: the next call returns it.
        """
        await self._attached()
        native = self._native
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            await native.ready(left)
            received = native.take()
            if received:
                return received[0]
            # Another task took it, or the time is over.
            if deadline is not None and time.monotonic() >= deadline:
                raise TimeoutError(f"nothing in {timeout} s")

    def __aiter__(self):
        return self

    async def __anext__(self):
        received = await self.recv()
        if received is None:
            raise StopAsyncIteration
        return received


class _Publishing(_Attaching):
    """A handle that publishes. `async with` flushes a reliable one at its end."""

    def __init__(self, attach, reliable):
        super().__init__(attach)
        self._reliable = reliable

    async def __aexit__(self, kind, *_):
        try:
            if self._reliable and self._native is not None:
                await self.flush()
        except _gdp.GdpError:
            # The program's own exception says more.
            if kind is None:
                raise
        finally:
            await super().__aexit__()

    async def flush(self, timeout=5.0):
        """Wait until every reader of a reliable publisher has acknowledged all messages."""
        await self._attached()
        await self._native.flush(timeout)

    async def wait_for_readers(self, readers=1):
        """Wait until so many readers are attached."""
        await self._attached()
        await self._native.wait_for_readers(readers)

    @property
    def readers(self):
        """The number of attached readers."""
        return 0 if self._native is None else self._native.readers


class Publisher(_Publishing):
    """Publishes bytes. Several tasks may use it."""

    async def put(self, payload):
        """Send bytes, or a text as UTF-8, and return the sequence number."""
        await self._attached()
        return await self._native.put(payload)


def _plain(value):
    """Return what JSON has for a value that it does not know."""
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode()
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a field cannot be {type(value).__name__}")


class RosPublisher(_Publishing):
    """Publishes ROS messages from dictionaries."""

    async def put(self, message):
        """Send a message and return its sequence number.

        `message` is a dictionary with fields, or a text in YAML. Omitted fields have their defaults.
        Arrays of bytes may be `bytes`, and arrays of numbers may be those of numpy.
        """
        await self._attached()
        try:
            text = message if isinstance(message, str) else json.dumps(message, default=_plain)
        except (TypeError, ValueError, RecursionError) as error:
            raise _gdp.MessageError(f"no ROS message: {error}") from None
        return await self._native.put_text(text)


class Subscriber(_Receiving):
    """Reads bytes: `async for sample in subscriber`."""


class Server(_Receiving):
    """Receives calls: `async for call in server: await call.reply(b"done")`."""


class RosSubscriber(_Receiving):
    """Reads ROS messages of any type: `async for message in subscriber`."""

    async def recv(self, timeout=None):
        """Return the next message, or None after the session is closed. Raises TimeoutError."""
        received = await super().recv(timeout)
        if received is None:
            return None
        type_name, value, source, sent = received
        return RosMessage(type_name, value, source, sent)


@dataclass(frozen=True)
class RosMessage:
    """A ROS message: its fields are in `value`, and `message["data"]` is `message.value["data"]`.

    Arrays of bytes are `bytes`, and floating-point fields are `float`, also NaN and infinities.
    """

    type_name: str
    value: Any
    source: str
    time: float

    def __getitem__(self, field):
        return self.value[field]


class Client(_Attaching):
    """Calls a service. Several tasks may use it."""

    async def call(self, request):
        """Send bytes or a text to the nearest server, and return its reply."""
        await self._attached()
        return await self._native.call(request)

    @property
    def servers(self):
        """The number of attached servers."""
        return 0 if self._native is None else self._native.servers


class Session(_Attaching):
    """An entity that is attached to a switch: `async with gdp.open() as session`."""

    async def __aexit__(self, kind, *_):
        try:
            await self.close()
        except _gdp.GdpError:
            # The program's own exception says more.
            if kind is None:
                raise

    async def close(self):
        """Wait for the readers of reliable publishers, for at most 5 s, and detach."""
        native, self._native, self._closed = self._native, None, True
        if native is not None:
            await native.close()

    @property
    def name(self):
        """The entity's name, for which owners issue certificates."""
        return self._open.name

    @property
    def _open(self):
        if self._native is None:
            raise _gdp.GdpError("the session is not open; use `async with gdp.open() as session`")
        return self._native

    def publisher(self, topic, *, reliable=False, latched=0, encoding="bytes"):
        """Publish a topic: a ROS name, a card's file, or a name of 64 hex digits or its first ones."""
        return Publisher(
            lambda: self._open.publisher(topic, reliable, latched, encoding), reliable
        )

    def subscribe(self, topic, *, newest=False):
        """Read a topic: named as for `publisher`, or /LABEL/TOPIC of another member."""
        return Subscriber(lambda: self._open.subscriber(topic, newest))

    def client(self, service, *, timeout=10.0):
        """Call a service, named as for `subscribe`."""
        return Client(lambda: self._open.client(service, timeout))

    def server(self, service):
        """Serve calls, as one of the servers of a service, named as for `publisher`."""
        return Server(lambda: self._open.server(service))

    def ros_publisher(
        self, topic, type_name, *, reliable=True, transient_local=False, depth=10, definitions=()
    ):
        """Publish ROS messages of a type such as std_msgs/msg/String."""
        folders = list(definitions)
        return RosPublisher(
            lambda: self._open.ros_publisher(
                topic, type_name, reliable, transient_local, depth, folders
            ),
            reliable,
        )

    def ros_subscribe(self, topic, *, definitions=()):
        """Read ROS messages of any type."""
        return RosSubscriber(lambda: self._open.ros_subscriber(topic, list(definitions)))


def open(keyring=None, switch=None, *, key=None, timeout=10.0):
    """Attach to a switch.

    keyring: folder with key, cards and certificates. Default: GDP_KEYRING, or ~/.config/gdp, or
    where this machine joined a domain. switch: such as udp://203.0.113.7:31415. Default: GDP_SWITCH,
    or where this machine joined, or this machine's own switch.
    """
    keyring = keyring or os.environ.get("GDP_KEYRING")
    switch_of = "switch" if switch else "GDP_SWITCH"
    switch = switch or os.environ.get("GDP_SWITCH")
    return Session(lambda: _gdp.open(keyring, switch, switch_of, key, timeout))
