"""Sessions with asyncio, over the extension module."""

from __future__ import annotations

import asyncio
import atexit
import base64
import json
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Generic, Optional, TypeVar, Union

from . import _gdp

Path = Union[str, "os.PathLike[str]"]
Payload = Union[bytes, bytearray, str]

# What the extension has for a handle.
N = TypeVar("N")
R = TypeVar("R", bound=Union[_gdp.Subscriber, _gdp.Server, _gdp.RosSubscriber])
P = TypeVar("P", bound=Union[_gdp.Publisher, _gdp.RosPublisher])
# What is received, and what is published.
T = TypeVar("T")
M = TypeVar("M")
H = TypeVar("H", bound="_Attaching[Any]")


class _Process:
    """Whether this process may use the extension, whose threads a fork does not copy."""

    def __init__(self) -> None:
        self.is_used = self.is_forked = False
        os.register_at_fork(after_in_child=self._forked)
        atexit.register(self._finish)

    def _forked(self) -> None:
        self.is_forked = self.is_used

    def _finish(self) -> None:
        if not self.is_forked:
            _gdp.finish()

    def use(self) -> None:
        if self.is_forked:
            raise _gdp.GdpError(
                "a session does not survive a fork; start processes with 'spawn', as"
                " multiprocessing.get_context('spawn') does, and open sessions in them"
            )
        self.is_used = True


_process = _Process()


class _Attaching(Generic[N]):
    """A handle that attaches when it is awaited, entered with `async with`, or iterated."""

    def __init__(self, attach: Callable[[], Awaitable[N]]) -> None:
        self._attach = attach
        self._native: Optional[N] = None
        self._attaching = asyncio.Lock()
        self._closed = False

    def __await__(self: H) -> Generator[Any, None, H]:
        return self.__aenter__().__await__()

    async def _attached(self) -> N:
        _process.use()
        # One task attaches, and others wait for it.
        async with self._attaching:
            if self._closed:
                raise _gdp.GdpError("it is closed; make another one")
            if self._native is None:
                self._native = await self._attach()
            return self._native

    async def __aenter__(self: H) -> H:
        await self._attached()
        return self

    async def __aexit__(self, kind: object, error: object, trace: object) -> None:
        # The extension withdraws the name when its object ends.
        self._native, self._closed = None, True


class _Receiving(_Attaching[R], Generic[R, T]):
    """A handle that receives, until the session is closed."""

    def _take(self, native: R) -> list[Optional[T]]:
        """Return what was received, in a list of at most one; None in it is the end."""
        raise NotImplementedError

    async def recv(self, timeout: Optional[float] = None) -> Optional[T]:
        """Return the next one, or None after the session is closed. Raises TimeoutError.

        A call that is cancelled or times out loses nothing: the next call returns it.
        """
        native = await self._attached()
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            await native.ready(left)
            received = self._take(native)
            if received:
                return received[0]
            # Another task took it, or the time is over.
            if deadline is not None and time.monotonic() >= deadline:
                raise TimeoutError(f"nothing in {timeout} s")

    def __aiter__(self) -> AsyncIterator[T]:
        return self

    async def __anext__(self) -> T:
        received = await self.recv()
        if received is None:
            raise StopAsyncIteration
        return received


class _Publishing(_Attaching[P], Generic[P, M]):
    """A handle that publishes. `async with` flushes a reliable one at its end."""

    def __init__(self, attach: Callable[[], Awaitable[P]], reliable: bool) -> None:
        super().__init__(attach)
        self._reliable = reliable

    async def __aexit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if self._reliable and self._native is not None:
                await self.flush()
        except _gdp.GdpError:
            # The program's own exception says more.
            if kind is None:
                raise
        finally:
            await super().__aexit__(kind, error, trace)

    async def put(self, message: M) -> int:
        """Send a message and return its sequence number."""
        raise NotImplementedError

    async def flush(self, timeout: float = 5.0) -> None:
        """Wait until every reader of a reliable publisher has acknowledged all messages."""
        native = await self._attached()
        await native.flush(timeout)

    async def wait_for_readers(self, readers: int = 1) -> None:
        """Wait until so many readers are attached."""
        native = await self._attached()
        await native.wait_for_readers(readers)

    @property
    def readers(self) -> int:
        """The number of attached readers."""
        return 0 if self._native is None else self._native.readers


class Publisher(_Publishing[_gdp.Publisher, Payload]):
    """Publishes bytes. Several tasks may use it."""

    async def put(self, payload: Payload) -> int:
        """Send bytes, or a text as UTF-8, and return the sequence number."""
        native = await self._attached()
        return await native.put(payload)


def _plain(value: Any) -> Any:
    """Return what JSON has for a value that it does not know."""
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode()
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a field cannot be {type(value).__name__}")


class RosPublisher(_Publishing[_gdp.RosPublisher, Union[dict[str, Any], str]]):
    """Publishes ROS messages from dictionaries."""

    async def put(self, message: Union[dict[str, Any], str]) -> int:
        """Send a message and return its sequence number.

        `message` is a dictionary with fields, or a text in YAML. Omitted fields have their defaults.
        Arrays of bytes may be `bytes`, and arrays of numbers may be those of numpy.
        """
        native = await self._attached()
        try:
            text = message if isinstance(message, str) else json.dumps(message, default=_plain)
        except (TypeError, ValueError, RecursionError) as error:
            raise _gdp.MessageError(f"no ROS message: {error}") from None
        return await native.put_text(text)


class Subscriber(_Receiving[_gdp.Subscriber, _gdp.Sample]):
    """Reads bytes: `async for sample in subscriber`."""

    def _take(self, native: _gdp.Subscriber) -> list[Optional[_gdp.Sample]]:
        return native.take()


class Server(_Receiving[_gdp.Server, _gdp.Call]):
    """Receives calls: `async for call in server: await call.reply(b"done")`."""

    def _take(self, native: _gdp.Server) -> list[Optional[_gdp.Call]]:
        return native.take()


@dataclass(frozen=True)
class RosMessage:
    """A ROS message: its fields are in `value`, and `message["data"]` is `message.value["data"]`.

    Arrays of bytes are `bytes`, and floating-point fields are `float`, also NaN and infinities.
    """

    type_name: str
    value: Any
    source: str
    time: float

    def __getitem__(self, field: str) -> Any:
        return self.value[field]


class RosSubscriber(_Receiving[_gdp.RosSubscriber, RosMessage]):
    """Reads ROS messages of any type: `async for message in subscriber`."""

    def _take(self, native: _gdp.RosSubscriber) -> list[Optional[RosMessage]]:
        return [None if received is None else RosMessage(*received) for received in native.take()]


class Client(_Attaching[_gdp.Client]):
    """Calls a service. Several tasks may use it."""

    async def call(self, request: Payload) -> _gdp.Sample:
        """Send bytes or a text to the nearest server, and return its reply."""
        native = await self._attached()
        return await native.call(request)

    @property
    def servers(self) -> int:
        """The number of attached servers."""
        return 0 if self._native is None else self._native.servers


class Session(_Attaching[_gdp.Session]):
    """An entity that is attached to a switch: `async with gdp.open() as session`."""

    async def __aexit__(self, kind: object, error: object, trace: object) -> None:
        try:
            await self.close()
        except _gdp.GdpError:
            # The program's own exception says more.
            if kind is None:
                raise

    async def close(self) -> None:
        """Wait for the readers of reliable publishers, for at most 5 s, and detach."""
        native, self._native, self._closed = self._native, None, True
        if native is not None:
            await native.close()

    @property
    def name(self) -> str:
        """The entity's name, for which owners issue certificates."""
        return self._open.name

    @property
    def _open(self) -> _gdp.Session:
        if self._native is None:
            raise _gdp.GdpError("the session is not open; use `async with gdp.open() as session`")
        return self._native

    def publisher(
        self, topic: str, *, reliable: bool = False, latched: int = 0, encoding: str = "bytes"
    ) -> Publisher:
        """Publish a topic: a ROS name, a card's file, or a name of 64 hex digits or its first ones."""
        return Publisher(
            lambda: self._open.publisher(topic, reliable, latched, encoding), reliable
        )

    def subscribe(self, topic: str, *, newest: bool = False) -> Subscriber:
        """Read a topic: named as for `publisher`, or /LABEL/TOPIC of another member."""
        return Subscriber(lambda: self._open.subscriber(topic, newest))

    def client(self, service: str, *, timeout: float = 10.0) -> Client:
        """Call a service, named as for `subscribe`."""
        return Client(lambda: self._open.client(service, timeout))

    def server(self, service: str) -> Server:
        """Serve calls, as one of the servers of a service, named as for `publisher`."""
        return Server(lambda: self._open.server(service))

    def ros_publisher(
        self,
        topic: str,
        type_name: str,
        *,
        reliable: bool = True,
        transient_local: bool = False,
        depth: int = 10,
        definitions: Iterable[Path] = (),
    ) -> RosPublisher:
        """Publish ROS messages of a type such as std_msgs/msg/String."""
        folders = list(definitions)
        return RosPublisher(
            lambda: self._open.ros_publisher(
                topic, type_name, reliable, transient_local, depth, folders
            ),
            reliable,
        )

    def ros_subscribe(self, topic: str, *, definitions: Iterable[Path] = ()) -> RosSubscriber:
        """Read ROS messages of any type."""
        folders = list(definitions)
        return RosSubscriber(lambda: self._open.ros_subscriber(topic, folders))


def open(
    keyring: Optional[Path] = None,
    switch: Optional[str] = None,
    *,
    key: Optional[Path] = None,
    timeout: float = 10.0,
) -> Session:
    """Attach to a switch.

    keyring: folder with key, cards and certificates. Default: GDP_KEYRING, or ~/.config/gdp, or
    where this machine joined a domain. switch: such as udp://203.0.113.7:31415. Default: GDP_SWITCH,
    or where this machine joined, or this machine's own switch.
    """
    folder = keyring or os.environ.get("GDP_KEYRING")
    switch_of = "switch" if switch else "GDP_SWITCH"
    target = switch or os.environ.get("GDP_SWITCH")
    return Session(lambda: _gdp.open(folder, target, switch_of, key, timeout))
