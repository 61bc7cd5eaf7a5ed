"""Reads and publishes ROS topics of any type, without ROS.

    python -m gdp.topic echo /chatter
    python -m gdp.topic pub /chatter std_msgs/msg/String '{data: hi}'
"""

from __future__ import annotations

import argparse
import base64
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Optional

from . import GdpError, MessageError, blocking


def arguments(argv: Optional[Sequence[str]] = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m gdp.topic", description="ROS topics of any type, without ROS")
    parser.add_argument("--keyring", help="folder with key, cards and certificates; default: GDP_KEYRING")
    parser.add_argument("--switch", help="switch to attach to, udp://HOST[:PORT]; default: GDP_SWITCH")
    parser.add_argument("--definitions", action="append", default=[], metavar="FOLDER",
                        help="share folder of ROS 2, for types beyond the common ones; repeat for several")
    verbs = parser.add_subparsers(dest="verb", required=True)
    echo = verbs.add_parser("echo", help="print the messages of a topic")
    echo.add_argument("topic")
    echo.add_argument("--once", action="store_true", help="end after the first message")
    echo.add_argument("--json", action="store_true", help="print one line of JSON a message")
    pub = verbs.add_parser("pub", help="publish messages of a type")
    pub.add_argument("topic")
    pub.add_argument("type", help="type of the topic, such as std_msgs/msg/String")
    pub.add_argument("values", nargs="?", default="{}", help="fields, in YAML or JSON")
    pub.add_argument("--rate", type=positive, default=1.0, help="messages a second")
    pub.add_argument("--times", type=count, help="number of messages; default: no limit")
    pub.add_argument("--readers", type=count, help="number of readers to wait for; default: 1 with --times, otherwise 0")
    return parser.parse_args(argv)


def positive(text: str) -> float:
    number = float(text)
    if not 0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number greater than zero")
    return number


def count(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text} is less than zero")
    return number


def printable(text: object) -> str:
    """Return a text without characters that steer a terminal or turn the direction of writing."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def as_json(value: Any) -> str:
    """Return JSON, in ASCII. It has base64 for bytes, and text for NaN and infinities."""
    return json.dumps(plain(value))


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: plain(field) for name, field in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def lines(value: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Return the lines of a value in YAML. Texts and numbers are those of JSON, which YAML includes."""
    for name, field in value.items():
        if isinstance(field, dict) and field:
            yield f"{indent}{printable(name)}:"
            yield from lines(field, indent + "  ")
        else:
            yield f"{indent}{printable(name)}: {as_json(field)}"


def echo(session: blocking.Session, options: argparse.Namespace) -> None:
    subscriber = session.ros_subscribe(options.topic, definitions=options.definitions)
    while True:
        try:
            message = subscriber.recv()
        except MessageError as error:
            print(f"gdp.topic: left out: {printable(error)}", file=sys.stderr)
            continue
        if message is None:
            return
        if options.json:
            print(as_json(message.value), flush=True)
        else:
            print("\n".join([*lines(message.value), "---"]), flush=True)
        if options.once:
            return


def pub(session: blocking.Session, options: argparse.Namespace) -> None:
    publisher = session.ros_publisher(options.topic, options.type, definitions=options.definitions)
    readers = options.readers if options.readers is not None else int(options.times is not None)
    publisher.wait_for_readers(readers)
    count = 0
    while options.times is None or count < options.times:
        if count:
            time.sleep(1 / options.rate)
        count += 1
        publisher.put(options.values)
        print(f"publishing #{count}: {printable(options.values)}", flush=True)
    publisher.flush()


def main(argv: Optional[Sequence[str]] = None) -> int:
    options = arguments(argv)
    try:
        with blocking.open(options.keyring, options.switch) as session:
            {"echo": echo, "pub": pub}[options.verb](session, options)
    except GdpError as error:
        print(f"gdp.topic: {printable(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Nobody reads the output; nothing must be written to it at the exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
