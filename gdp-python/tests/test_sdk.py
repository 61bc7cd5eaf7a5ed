"""The package at a real switch. The harness in Rust makes it, and keyrings of a robot and a laptop."""

import asyncio
import json
import os
import subprocess
import sys
import threading
import time

import pytest

import gdp
import gdp.blocking
import gdp.topic

SWITCH = os.environ["GDP_TEST_SWITCH"]
KEYRINGS = os.environ["GDP_TEST_KEYRINGS"]
TIMEOUT = 30


def keyring(label):
    return os.path.join(KEYRINGS, label)


def opened(label):
    return gdp.open(keyring(label), SWITCH)


def run(main):
    asyncio.run(asyncio.wait_for(main, TIMEOUT))


def test_messages_arrive_in_order_with_their_source():
    async def main():
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


def test_a_server_answers_a_client():
    async def main():
        async with opened("robot") as robot, opened("laptop") as laptop:

            async def serve():
                async for call in robot.server("/light"):
                    assert call.source == laptop.name
                    await call.reply(b"the light is " + call.payload)

            serving = asyncio.create_task(serve())
            client = await laptop.client("/light")
            replies = await asyncio.gather(client.call("on"), client.call(b"off"))
            assert [reply.payload for reply in replies] == [b"the light is on", b"the light is off"]
            serving.cancel()

    run(main())


def test_ros_messages_are_dictionaries():
    async def main():
        async with opened("robot") as robot, opened("laptop") as laptop:
            subscriber = await laptop.ros_subscribe("/twist")
            publisher = await robot.ros_publisher("/twist", "geometry_msgs/msg/Twist")
            await publisher.wait_for_readers()
            await publisher.put({"linear": {"x": 0.5}})
            message = await subscriber.recv()
            zero = {"x": 0, "y": 0, "z": 0}
            assert message.type_name == "geometry_msgs/msg/Twist" and message["linear"] == {**zero, "x": 0.5}
            assert message["angular"] == zero and message.source == robot.name
            for wrong in [{"linear": 1}, {"lineal": {}}]:
                with pytest.raises(gdp.MessageError, match="line"):
                    await publisher.put(wrong)
            with pytest.raises(gdp.GdpError, match="geometry_msgs/msg/Twist"):
                await robot.ros_publisher("/twist", "std_msgs/msg/String")

    run(main())


def test_what_is_missing_is_an_exception_with_its_remedy(tmp_path):
    async def main():
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


def test_the_blocking_form_does_the_same():
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
        call = server.recv(timeout=TIMEOUT)
        call.reply(call.payload + b"!")
        asking.join()
        assert replies == ["on!"]


def test_another_thread_that_waits_ends_with_the_session():
    session = gdp.blocking.open(keyring("laptop"), SWITCH)
    subscriber, outcomes = session.subscribe("/bytes"), []

    def wait():
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


def test_two_tasks_attach_one_handle_and_its_end_flushes():
    async def main():
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


def command(label, *arguments):
    environment = {**os.environ, "GDP_KEYRING": keyring(label), "GDP_SWITCH": SWITCH}
    return subprocess.Popen([sys.executable, "-m", "gdp.topic", *arguments], env=environment,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_topic_echo_prints_what_topic_pub_publishes():
    echo = command("laptop", "echo", "/text", "--once")
    pub = command("robot", "pub", "/text", "std_msgs/msg/String", "{data: hi}", "--times", "1", "--readers", "1")
    assert pub.communicate(timeout=TIMEOUT) == ("publishing #1: {data: hi}\n", "")
    assert echo.communicate(timeout=TIMEOUT) == ('data: "hi"\n---\n', "")
    assert (pub.returncode, echo.returncode) == (0, 0)
    refused = command("laptop", "echo", "/nothing")
    output, errors = refused.communicate(timeout=TIMEOUT)
    assert refused.returncode == 1 and output == "" and errors.startswith("gdp.topic: no name card of a topic /nothing")
