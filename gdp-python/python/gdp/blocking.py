"""The same as `gdp`, without asyncio: every method waits.

    with gdp.blocking.open() as session:
        for sample in session.subscribe("/chatter"):
            print(sample.payload)

Each session has a thread with a loop of asyncio. Handles may be used from any thread.
"""

from __future__ import annotations

import asyncio
import atexit
import concurrent.futures
import sys
import threading
import weakref
from collections.abc import Coroutine, Iterable, Iterator
from typing import Any, Generic, Optional, TypeVar, Union

from . import _gdp, _session
from ._gdp import GdpError, Sample
from ._session import Path, Payload, RosMessage

T = TypeVar("T")
# What is published.
M = TypeVar("M")
# The handle of `gdp`.
A = TypeVar("A", bound="_session._Attaching[Any]")
H = TypeVar("H", bound="_Handle[Any]")


class _Loop:
    """A loop of asyncio in a thread of its own."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, name="gdp", daemon=True)
        self.thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        try:
            _session._process.use()
        except GdpError:
            coroutine.close()
            raise
        if not self.thread.is_alive() or self.loop.is_closed():
            coroutine.close()
            raise GdpError("the session is closed")
        waiting = asyncio.run_coroutine_threadsafe(coroutine, self.loop)
        try:
            return waiting.result()
        except (asyncio.CancelledError, concurrent.futures.CancelledError):
            raise GdpError("the session was closed") from None
        except BaseException:
            # Also after ^C: what nobody waits for is given up.
            waiting.cancel()
            raise

    def stop(self) -> None:
        async def give_up() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        # Other threads may wait for a message.
        self.run(give_up())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


class _Handle(Generic[A]):
    """A handle of `gdp` whose methods wait."""

    def __init__(self, loop: _Loop, handle: A) -> None:
        self._loop, self._handle = loop, handle
        loop.run(handle._attached())

    def __enter__(self: H) -> H:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._loop.run(self._handle.__aexit__(kind, error, trace))


class _Receiving(_Handle[_session._Receiving[Any, Any]], Generic[T]):
    def recv(self, timeout: Optional[float] = None) -> Optional[T]:
        """Return the next one, or None after the session is closed. Raises TimeoutError."""
        received: Optional[T] = self._loop.run(self._handle.recv(timeout))
        return received

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        received = self.recv()
        if received is None:
            raise StopIteration
        return received


class Publisher(_Handle[_session._Publishing[Any, M]], Generic[M]):
    """Publishes bytes, or ROS messages."""

    def put(self, message: M) -> int:
        """Send a message, and return its sequence number."""
        return self._loop.run(self._handle.put(message))

    def flush(self, timeout: float = 5.0) -> None:
        """Wait until every reader of a reliable publisher has acknowledged all messages."""
        self._loop.run(self._handle.flush(timeout))

    def wait_for_readers(self, readers: int = 1) -> None:
        """Wait until so many readers are attached."""
        self._loop.run(self._handle.wait_for_readers(readers))

    @property
    def readers(self) -> int:
        """The number of attached readers."""
        return self._handle.readers


class Subscriber(_Receiving[T]):
    """Reads bytes, or ROS messages: `for sample in subscriber`."""


class Call:
    """A call that waits for its reply."""

    def __init__(self, loop: _Loop, call: _gdp.Call) -> None:
        self._loop, self._call = loop, call

    @property
    def payload(self) -> bytes:
        """The content of the request."""
        return self._call.payload

    @property
    def source(self) -> str:
        """The entity that calls."""
        return self._call.source

    def reply(self, payload: Payload) -> None:
        """Reply to the caller."""

        async def send() -> None:
            await self._call.reply(payload)

        self._loop.run(send())


class Server(_Receiving[Call]):
    """Receives calls: `for call in server: call.reply(b"done")`."""

    def recv(self, timeout: Optional[float] = None) -> Optional[Call]:
        """Return the next call, or None after the session is closed. Raises TimeoutError."""
        call = self._loop.run(self._handle.recv(timeout))
        return None if call is None else Call(self._loop, call)


class Client(_Handle[_session.Client]):
    """Calls a service."""

    def call(self, request: Payload) -> Sample:
        """Send bytes or a text to the nearest server, and return its reply."""
        return self._loop.run(self._handle.call(request))

    @property
    def servers(self) -> int:
        """The number of attached servers."""
        return self._handle.servers


# Those that a program leaves open. They are closed when Python ends, if no fork has copied them.
_open_sessions: weakref.WeakSet[Session] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    if not _session._process.is_forked:
        for session in list(_open_sessions):
            try:
                session.close()
            except GdpError as error:
                print(f"gdp: {error}", file=sys.stderr)


class Session(_Handle[_session.Session]):
    """An entity that is attached to a switch: `with gdp.blocking.open() as session`.

    A session that is still open when Python ends is closed then.
    """

    def __init__(self, loop: _Loop, handle: _session.Session) -> None:
        super().__init__(loop, handle)
        self._closed = False
        _open_sessions.add(self)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            self.close()
        except GdpError:
            # The program's own exception says more.
            if kind is None:
                raise

    def close(self) -> None:
        """Wait for the readers of reliable publishers, for at most 5 s, and detach."""
        if not self._closed:
            self._closed = True
            try:
                self._loop.run(self._handle.close())
            finally:
                self._loop.stop()

    @property
    def name(self) -> str:
        """The entity's name, for which owners issue certificates."""
        return self._handle.name

    def publisher(
        self, topic: str, *, reliable: bool = False, latched: int = 0, encoding: str = "bytes"
    ) -> Publisher[Payload]:
        """Publish a topic, as `gdp.Session.publisher` does."""
        handle = self._handle.publisher(topic, reliable=reliable, latched=latched, encoding=encoding)
        return Publisher(self._loop, handle)

    def subscribe(self, topic: str, *, newest: bool = False) -> Subscriber[Sample]:
        """Read a topic, as `gdp.Session.subscribe` does."""
        return Subscriber(self._loop, self._handle.subscribe(topic, newest=newest))

    def client(self, service: str, *, timeout: float = 10.0) -> Client:
        """Call a service, as `gdp.Session.client` does."""
        return Client(self._loop, self._handle.client(service, timeout=timeout))

    def server(self, service: str) -> Server:
        """Serve calls, as `gdp.Session.server` does."""
        return Server(self._loop, self._handle.server(service))

    def ros_publisher(
        self,
        topic: str,
        type_name: str,
        *,
        reliable: bool = True,
        transient_local: bool = False,
        depth: int = 10,
        definitions: Iterable[Path] = (),
    ) -> Publisher[Union[dict[str, Any], str]]:
        """Publish ROS messages, as `gdp.Session.ros_publisher` does."""
        handle = self._handle.ros_publisher(
            topic,
            type_name,
            reliable=reliable,
            transient_local=transient_local,
            depth=depth,
            definitions=definitions,
        )
        return Publisher(self._loop, handle)

    def ros_subscribe(self, topic: str, *, definitions: Iterable[Path] = ()) -> Subscriber[RosMessage]:
        """Read ROS messages, as `gdp.Session.ros_subscribe` does."""
        return Subscriber(self._loop, self._handle.ros_subscribe(topic, definitions=definitions))


def open(
    keyring: Optional[Path] = None,
    switch: Optional[str] = None,
    *,
    key: Optional[Path] = None,
    timeout: float = 10.0,
) -> Session:
    """Attach to a switch, as `gdp.open` does."""
    loop = _Loop()
    try:
        return Session(loop, _session.open(keyring, switch, key=key, timeout=timeout))
    except BaseException:
        loop.stop()
        raise
