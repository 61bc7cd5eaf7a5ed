"""The package at a real switch. The harness in Rust makes it, and keyrings of a robot and a laptop."""

import asyncio
import importlib.metadata
import json
import math
import os
import pathlib
import subprocess
import sys
import threading
import time
from collections.abc import Coroutine
from typing import Any, Optional, TypeVar

import pytest

import gdp
import gdp.blocking
import gdp.topic

SWITCH = os.environ["GDP_TEST_SWITCH"]
KEYRINGS = os.environ["GDP_TEST_KEYRINGS"]
TIMEOUT = 30


def keyring(label: str) -> str:
    return os.path.join(KEYRINGS, label)


def opened(label: str) -> gdp.Session:
    return gdp.open(keyring(label), SWITCH)


def run(main: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(main, TIMEOUT))


T = TypeVar("T")


def some(received: Optional[T]) -> T:
    assert received is not None, "the session is open"
    return received


def test_the_package_is_the_installed_one() -> None:
    assert pathlib.Path(gdp.__file__).is_relative_to(sys.prefix)
    assert importlib.metadata.version("gdp") == "0.1.0"
    errors = [gdp.ConfigError, gdp.LinkError, gdp.MessageError, gdp.NoReplyError, gdp.NotFoundError, gdp.RightsError]
    assert all(error.__bases__ == (gdp.GdpError,) for error in errors)


def test_messages_arrive_in_order_with_their_source() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.subscribe("/bytes")
            publisher = await robot.publisher("/bytes", reliable=True, encoding="json")
            await publisher.wait_for_readers()
            await asyncio.gather(*(publisher.put(json.dumps(i)) for i in range(100)))
            await publisher.put(b"end")
            got = []
            async for sample in subscriber:
                if sample.payload == b"end":
                    break
                got.append(sample)
            assert sorted(int(sample.text()) for sample in got) == list(range(100))
            assert [sample.sequence for sample in got] == list(range(got[0].sequence, got[0].sequence + 100))
            assert {sample.source for sample in got} == {robot.name}
            assert got[0].encoding == "json" and abs(got[0].time - time.time()) < TIMEOUT

    run(main())


def test_a_server_answers_a_client() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:

            async def serve() -> None:
                async for call in robot.server("/light"):
                    assert call.source == laptop.name
                    reply = call.reply(b"the light is " + call.payload)
                    assert isinstance(reply, asyncio.Future), "as the stub says, which mypy cannot compare"
                    await reply

            serving = asyncio.create_task(serve())
            client = await laptop.client("/light")
            replies = await asyncio.gather(client.call("on"), client.call(b"off"))
            assert [reply.payload for reply in replies] == [b"the light is on", b"the light is off"]
            serving.cancel()

    run(main())


def test_ros_messages_are_dictionaries() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.ros_subscribe("/twist")
            publisher = await robot.ros_publisher("/twist", "geometry_msgs/msg/Twist")
            await publisher.wait_for_readers()
            await publisher.put({"linear": {"x": 0.5}})
            message = some(await subscriber.recv())
            zero = {"x": 0, "y": 0, "z": 0}
            assert message.type_name == "geometry_msgs/msg/Twist" and message["linear"] == {**zero, "x": 0.5}
            assert message["angular"] == zero and message.source == robot.name
            wrongs: list[dict[str, Any]] = [{"linear": 1}, {"lineal": {}}]
            for wrong in wrongs:
                with pytest.raises(gdp.MessageError, match="line"):
                    await publisher.put(wrong)
            with pytest.raises(gdp.GdpError, match="geometry_msgs/msg/Twist"):
                await robot.ros_publisher("/twist", "std_msgs/msg/String")

    run(main())


def test_what_is_missing_is_an_exception_with_its_remedy(tmp_path: pathlib.Path) -> None:
    async def main() -> None:
        with pytest.raises(gdp.ConfigError, match="no keyring"):
            await gdp.open(tmp_path / "nowhere", SWITCH)
        with pytest.raises(gdp.ConfigError, match="no link"):
            await gdp.open(keyring("robot"), "nonsense")
        async with opened("laptop") as laptop:
            with pytest.raises(gdp.NotFoundError, match="/nothing"):
                await laptop.subscribe("/nothing")
            with pytest.raises(gdp.RightsError, match="gdp-ctl grant add"):
                await laptop.publisher("/bytes")
            with pytest.raises(gdp.NoReplyError, match="/light"):
                await laptop.client("/light", timeout=0.2).call("on")
            subscriber = await laptop.subscribe("/bytes")
            # Cancelled, it goes on to receive.
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(subscriber.recv(), 0.1)
        assert await subscriber.recv() is None, "the session is closed"
        with pytest.raises(gdp.GdpError, match="not open"):
            laptop.name

    run(main())


def test_the_blocking_form_does_the_same() -> None:
    with gdp.blocking.open(keyring("robot"), SWITCH) as robot, gdp.blocking.open(keyring("laptop"), SWITCH) as laptop:
        subscriber = laptop.subscribe("/bytes")
        with pytest.raises(TimeoutError):
            subscriber.recv(timeout=0.1)
        with robot.publisher("/bytes", reliable=True) as publisher:
            publisher.wait_for_readers()
            publisher.put("hello")
            publisher.flush()
        assert next(subscriber).payload == b"hello"
        server, replies = robot.server("/light"), []
        asking = threading.Thread(target=lambda: replies.append(laptop.client("/light").call("on").text()))
        asking.start()
        call = some(server.recv(timeout=TIMEOUT))
        call.reply(call.payload + b"!")
        asking.join()
        assert replies == ["on!"]


def test_another_thread_that_waits_ends_with_the_session() -> None:
    session = gdp.blocking.open(keyring("laptop"), SWITCH)
    subscriber = session.subscribe("/bytes")
    outcomes: list[object] = []

    def wait() -> None:
        try:
            outcomes.append(subscriber.recv())
        except gdp.GdpError as error:
            outcomes.append(error)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    time.sleep(0.3)
    session.close()
    waiting.join(TIMEOUT)
    assert not waiting.is_alive() and len(outcomes) == 1, outcomes
    with pytest.raises(gdp.GdpError, match="closed"):
        subscriber.recv()


def test_two_tasks_attach_one_handle_and_its_end_flushes() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.subscribe("/bytes")
            async with robot.publisher("/bytes", reliable=True) as publisher:
                await publisher.wait_for_readers()
                await asyncio.gather(*(publisher.put(str(i)) for i in range(50)))
            for _ in range(50):
                assert await subscriber.recv() is not None
            with pytest.raises(gdp.GdpError, match="closed"):
                await publisher.put("late")
            racing = laptop.client("/light", timeout=0.1)
            results = await asyncio.gather(racing.call("a"), racing.call("b"), return_exceptions=True)
            assert [type(result) for result in results] == [gdp.NoReplyError] * 2, results

    run(main())


def test_giving_up_loses_no_message() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.subscribe("/bytes")
            publisher = await robot.publisher("/bytes", reliable=True)
            await publisher.wait_for_readers()

            async def talk() -> None:
                for i in range(400):
                    await publisher.put(str(i))
                    await asyncio.sleep(0.001)

            talking, given_up, attempts = asyncio.create_task(talk()), 0, 0
            got: list[int] = []
            while len(got) < 400:
                receiving = asyncio.create_task(subscriber.recv(0.0015 if len(got) % 3 == 0 else None))
                attempts += 1
                # Every second one hardly begins, so that many are given up on any machine.
                await asyncio.sleep(0 if attempts % 2 else 0.002)
                receiving.cancel()
                try:
                    got.append(int(some(await receiving).text()))
                except (asyncio.CancelledError, TimeoutError):
                    given_up += 1
            await talking
            assert got == list(range(400)) and given_up > 10, given_up
            with pytest.raises(TimeoutError):
                await subscriber.recv(0.05)
            await publisher.put("at once")
            await publisher.flush()
            await asyncio.sleep(0.5)
            assert some(await subscriber.recv(0)).text() == "at once"

    run(main())


def test_giving_up_loses_no_message_in_the_blocking_form() -> None:
    with gdp.blocking.open(keyring("robot"), SWITCH) as robot, gdp.blocking.open(keyring("laptop"), SWITCH) as laptop:
        subscriber, publisher = laptop.subscribe("/bytes"), robot.publisher("/bytes", reliable=True)
        publisher.wait_for_readers()

        def talk() -> None:
            for i in range(200):
                publisher.put(str(i))
                time.sleep(0.001)

        talking, given_up, attempts = threading.Thread(target=talk), 0, 0
        got: list[int] = []
        talking.start()
        while len(got) < 200:
            attempts += 1
            try:
                got.append(int(some(subscriber.recv(timeout=0.0005 * (attempts % 2))).text()))
            except TimeoutError:
                given_up += 1
        talking.join()
        assert got == list(range(200)) and given_up > 10, given_up


def test_values_of_ros_are_those_of_python() -> None:
    async def main() -> None:
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.ros_subscribe("/scan")
            publisher = await robot.ros_publisher("/scan", "sensor_msgs/msg/LaserScan")
            await publisher.wait_for_readers()
            await publisher.put({"ranges": [1, math.inf, -math.inf, math.nan], "range_max": math.inf})
            ranges = some(await subscriber.recv())["ranges"]
            assert ranges[:3] == [1.0, math.inf, -math.inf] and math.isnan(ranges[3]), ranges
            assert {type(value) for value in ranges} == {float} and min(ranges[:3]) == -math.inf
            with pytest.raises(gdp.MessageError, match="set"):
                await publisher.put({"ranges": {1}})
            image = await laptop.ros_subscribe("/image")
            camera = await robot.ros_publisher("/image", "sensor_msgs/msg/Image")
            await camera.wait_for_readers()
            await camera.put({"data": bytes(range(256)), "height": 1})
            got = some(await image.recv())
            assert got["data"] == bytes(range(256)) and got["height"] == 1 and got["header"]["stamp"]["sec"] == 0
            assert gdp.topic.as_json({"a": ranges, "b": b"hi"}) == \
                '{"a": [1.0, "Infinity", "-Infinity", "NaN"], "b": "aGk="}'

    run(main())


def test_wrong_arguments_are_named() -> None:
    async def main() -> None:
        with pytest.raises(gdp.ConfigError, match="^switch: "):
            await gdp.open(keyring("robot"), "nonsense")
        async with opened("robot") as robot:
            publisher = await robot.publisher("/bytes")
            with pytest.raises(TypeError, match="bytes, bytearray or str, and not int"):
                await publisher.put(5)  # type: ignore[arg-type]

    run(main())


PROGRAM = """
import os, gdp, gdp.blocking
session = gdp.blocking.open()
publisher = session.publisher("/bytes", reliable=True)
publisher.wait_for_readers()
publisher.put("last words")
child = os.fork()
if child == 0:
    try:
        publisher.put("from the child")
    except gdp.GdpError as error:
        os._exit(7 if "spawn" in str(error) else 8)
    os._exit(9)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_a_forked_process_is_refused_and_the_end_of_python_closes_sessions() -> None:
    with gdp.blocking.open(keyring("laptop"), SWITCH) as laptop:
        subscriber = laptop.subscribe("/bytes")
        environment = {**os.environ, "GDP_KEYRING": keyring("robot"), "GDP_SWITCH": SWITCH}
        program = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True,
                                 text=True, timeout=TIMEOUT)
        assert (program.stdout, program.returncode) == ("7\n", 0), program.stderr
        assert some(subscriber.recv(timeout=TIMEOUT)).text() == "last words"


def test_texts_of_others_do_not_steer_the_terminal() -> None:
    assert gdp.topic.printable("a\x1b[2J\u202eb\n") == "a\\x1b[2J\\u202eb\\n"
    assert list(gdp.topic.lines({"a\x1b": "\x1b"})) == ['a\\x1b: "\\u001b"']


def command(label: str, *arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "GDP_KEYRING": keyring(label), "GDP_SWITCH": SWITCH}
    return subprocess.Popen([sys.executable, "-m", "gdp.topic", *arguments], env=environment,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_topic_echo_prints_what_topic_pub_publishes() -> None:
    echo = command("laptop", "echo", "/text", "--once")
    pub = command("robot", "pub", "/text", "std_msgs/msg/String", "{data: hi}", "--times", "1", "--readers", "1")
    assert pub.communicate(timeout=TIMEOUT) == ("publishing #1: {data: hi}\n", "")
    assert echo.communicate(timeout=TIMEOUT) == ('data: "hi"\n---\n', "")
    assert (pub.returncode, echo.returncode) == (0, 0)
    refused = command("laptop", "echo", "/nothing")
    output, errors = refused.communicate(timeout=TIMEOUT)
    assert refused.returncode == 1 and output == "" and errors.startswith("gdp.topic: no name card of a topic /nothing")
