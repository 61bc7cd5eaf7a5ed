"""The same as `gdp`, without asyncio: every method waits.

    with gdp.blocking.open() as session:
        for sample in session.subscribe("/chatter"):
            print(sample.payload)

Each session has a thread with a loop of asyncio. Handles may be used from any thread.
"""

import asyncio
import atexit
import concurrent.futures
import sys
import threading
import weakref

from . import _session
from ._gdp import GdpError


class _Loop:
    """A loop of asyncio in a thread of its own."""

    def __init__(self):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, name="gdp", daemon=True)
        self.thread.start()

    def run(self, coroutine, timeout=None):
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
            return waiting.result(timeout)
        except (asyncio.CancelledError, concurrent.futures.CancelledError):
            raise GdpError("the session was closed") from None
        except BaseException:
            # Also after ^C: what nobody waits for is given up.
            waiting.cancel()
            raise

    def stop(self):
        async def give_up():
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        # Other threads may wait for a message.
        self.run(give_up())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


class _Handle:
    """A handle of `gdp` whose methods wait."""

    def __init__(self, loop, handle):
        self._loop, self._handle = loop, handle
        loop.run(handle._attached())

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._loop.run(self._handle.__aexit__(*exception))


class _Receiving(_Handle):
    def recv(self, timeout=None):
        """Return the next one, or None after the session is closed. Raises TimeoutError."""
        return self._loop.run(self._handle.recv(timeout))

    def __iter__(self):
        return self

    def __next__(self):
        received = self.recv()
        if received is None:
            raise StopIteration
        return received


class Publisher(_Handle):
    """Publishes bytes, or ROS messages."""

    def put(self, message):
        """Send a message, and return its sequence number."""
        return self._loop.run(self._handle.put(message))

    def flush(self, timeout=5.0):
        """Wait until every reader of a reliable publisher has acknowledged all messages."""
        self._loop.run(self._handle.flush(timeout))

    def wait_for_readers(self, readers=1):
        """Wait until so many readers are attached."""
        self._loop.run(self._handle.wait_for_readers(readers))

    @property
    def readers(self):
        """The number of attached readers."""
        return self._handle.readers


class Subscriber(_Receiving):
    """Reads bytes, or ROS messages: `for sample in subscriber`."""


class Server(_Receiving):
    """Receives calls: `for call in server: call.reply(b"done")`."""

    def recv(self, timeout=None):
        """Return the next call, or None after the session is closed. Raises TimeoutError."""
        call = super().recv(timeout)
        return None if call is None else Call(self._loop, call)


class Call:
    """A call that waits for its reply."""

    def __init__(self, loop, call):
        self._loop, self._call = loop, call

    @property
    def payload(self):
        """The content of the request."""
        return self._call.payload

    @property
    def source(self):
        """The entity that calls."""
        return self._call.source

    def reply(self, payload):
        """Reply to the caller."""

        async def send():
            await self._call.reply(payload)

        self._loop.run(send())


class Client(_Handle):
    """Calls a service."""

    def call(self, request):
        """Send bytes or a text to the nearest server, and return its reply."""
        return self._loop.run(self._handle.call(request))

    @property
    def servers(self):
        """The number of attached servers."""
        return self._handle.servers


# Those that a program leaves open. They are closed when Python ends, if no fork has copied them.
_open_sessions = weakref.WeakSet()


@atexit.register
def _close_all():
    if not _session._process.is_forked:
        for session in list(_open_sessions):
            try:
                session.close()
            except GdpError as error:
                print(f"gdp: {error}", file=sys.stderr)


class Session(_Handle):
    """An entity that is attached to a switch: `with gdp.blocking.open() as session`.

    A session that is still open when Python ends is closed then.
    """

    def __init__(self, loop, handle):
        super().__init__(loop, handle)
        _open_sessions.add(self)

    def __exit__(self, kind, *_):
        try:
            self.close()
        except GdpError:
            # The program's own exception says more.
            if kind is None:
                raise

    def close(self):
        """Wait for the readers of reliable publishers, for at most 5 s, and detach."""
        if self._loop is not None:
            loop, self._loop = self._loop, None
            try:
                loop.run(self._handle.close())
            finally:
                loop.stop()

    @property
    def name(self):
        """The entity's name, for which owners issue certificates."""
        return self._handle.name

    def publisher(self, topic, **options):
        """Publish a topic, as `gdp.Session.publisher` does."""
        return Publisher(self._loop, self._handle.publisher(topic, **options))

    def subscribe(self, topic, **options):
        """Read a topic, as `gdp.Session.subscribe` does."""
        return Subscriber(self._loop, self._handle.subscribe(topic, **options))

    def client(self, service, **options):
        """Call a service, as `gdp.Session.client` does."""
        return Client(self._loop, self._handle.client(service, **options))

    def server(self, service):
        """Serve calls, as `gdp.Session.server` does."""
        return Server(self._loop, self._handle.server(service))

    def ros_publisher(self, topic, type_name, **options):
        """Publish ROS messages, as `gdp.Session.ros_publisher` does."""
        return Publisher(self._loop, self._handle.ros_publisher(topic, type_name, **options))

    def ros_subscribe(self, topic, **options):
        """Read ROS messages, as `gdp.Session.ros_subscribe` does."""
        return Subscriber(self._loop, self._handle.ros_subscribe(topic, **options))


def open(keyring=None, switch=None, **options):
    """Attach to a switch, as `gdp.open` does."""
    loop = _Loop()
    try:
        return Session(loop, _session.open(keyring, switch, **options))
    except BaseException:
        loop.stop()
        raise
