"""A node of a graph of rmw_zenoh, by zenoh-ros2-sdk and eclipse-zenoh. See README.md."""

import argparse
import json
import logging
import sys
import time
import zlib

import zenoh
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import compute_service_type_hash, get_type_hash

STRING = "std_msgs/msg/String"
DDS = "std_msgs::msg::dds_::String_"
DEFINITION = "string data\n"
SET_BOOL = {
    "srv_type": "std_srvs/srv/SetBool",
    "request_definition": "bool data\n",
    "response_definition": "bool success\nstring message\n",
}
LATCHED = ":1:,10:,:,:,,"


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["router", "watch", "talk", "listen", "latch", "late", "hostile", "misanswer", "switch", "set"])
    p.add_argument("--port", type=int, required=True)
    p.add_argument("--topic", default="/chatter")
    p.add_argument("--service", nargs="+", default=["/light"])
    p.add_argument("--node", default="talker")
    p.add_argument("--namespace", default="/")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--text", default="hello from zenoh")
    return p.parse_args()


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def common(args):
    return {
        "domain_id": 0,
        "router_port": args.port,
        "node_name": args.node,
        "namespace": args.namespace,
    }


def stamped(sequence, text):
    crc = zlib.crc32(text.encode())
    return f"{sequence:010} {time.monotonic_ns():020} {crc:010} {text}"


def cdr(text):
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def text_of(payload):
    return payload[8 : 8 + int.from_bytes(payload[4:8], "little") - 1].decode()


def heard(text):
    fields = text.split(" ", 3)
    if len(fields) == 4 and fields[0].isdigit():
        sequence, words = int(fields[0]), fields[3]
        say(event="message", seq=sequence, text=words, intact=int(fields[2]) == zlib.crc32(words.encode()))
    else:
        say(event="message", text=text)


def router(args):
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{args.port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    say(event="ready")
    return session


def watch(args):
    session = ZenohSession.get_instance("127.0.0.1", args.port).session

    def changed(sample):
        say(event="token" if sample.kind == zenoh.SampleKind.PUT else "end", token=str(sample.key_expr))

    def message(sample):
        attachment = sample.attachment
        say(event="data", key=str(sample.key_expr), attachment=attachment and attachment.to_bytes().hex())

    liveliness = session.liveliness().declare_subscriber("@ros2_lv/**", changed, history=True)
    data = session.declare_subscriber("0/**", message)
    say(event="ready")
    return liveliness, data


def talk(args):
    publisher = ROS2Publisher(topic=args.topic, msg_type=STRING, msg_definition=DEFINITION, **common(args))
    say(event="ready")
    sequence = 0
    while not args.count or sequence < args.count:
        publisher.publish(data=stamped(sequence, args.text))
        sequence += 1
        time.sleep(1 / args.rate)
    say(event="done", sent=sequence)
    return publisher


def listen(args):
    subscriber = ROS2Subscriber(
        topic=args.topic,
        msg_type=STRING,
        msg_definition=DEFINITION,
        callback=lambda message: heard(message.data),
        **common(args),
    )
    say(event="ready")
    return subscriber


class Endpoint:
    """An endpoint with its tokens, as rmw_zenoh has them. The SDK has no transient_local."""

    def __init__(self, args, kind, qos):
        self.manager = ZenohSession.get_instance("127.0.0.1", args.port)
        self.hash = get_type_hash(STRING, msg_definition=DEFINITION)
        node = NodeEntity(0, self.manager.session_id, 1, args.node, args.namespace)
        self.key = topic_keyexpr(0, args.topic, DDS, self.hash)
        self.token = endpoint_liveliness_keyexpr(EndpointEntity(node, 2, kind, args.topic, DDS, self.hash, qos))
        tokens = [node_liveliness_keyexpr(node), self.token]
        self.tokens = [self.manager.session.liveliness().declare_token(token) for token in tokens]
        self.sequence = 0

    def attachment(self):
        self.sequence += 1
        now = time.time_ns()
        return self.sequence.to_bytes(8, "little") + now.to_bytes(8, "little") + b"\x10" + bytes(range(16))


def latch(args):
    endpoint = Endpoint(args, EntityKind.PUBLISHER, LATCHED)
    publisher = zenoh.ext.declare_advanced_publisher(
        endpoint.manager.session,
        endpoint.key,
        cache=zenoh.ext.CacheConfig(10),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(sporadic_heartbeat=0.5),
    )
    for sequence in range(args.count or 1):
        publisher.put(cdr(stamped(sequence, args.text)), attachment=endpoint.attachment())
    say(event="ready")
    return endpoint, publisher


def late(args):
    endpoint = Endpoint(args, EntityKind.SUBSCRIPTION, LATCHED)
    subscriber = zenoh.ext.declare_advanced_subscriber(
        endpoint.manager.session,
        endpoint.key,
        lambda sample: heard(text_of(sample.payload.to_bytes())),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=10),
        subscriber_detection=True,
    )
    say(event="ready")
    return endpoint, subscriber


def hostile(args):
    """Publishes what nobody may carry, and a good message in between."""
    endpoint = Endpoint(args, EntityKind.PUBLISHER, "::,10:,:,:,,")
    session, good = endpoint.manager.session, endpoint.attachment()
    publisher = session.declare_publisher(endpoint.key)
    broken = ["@ros2_lv/0/x/1/2/MP", "@ros2_lv/0/ab/1/2/XX/%/%/n", endpoint.token + "/more"]
    broken += [endpoint.token.replace("::,10", "9:9:x"), endpoint.token.replace("/MP/", "/NN/")]
    broken += [f"@ros2_lv/0/ab/1/{i}/SS/%/%/n/{'s' * (i + 1)}" for i in range(100)]
    tokens = [session.liveliness().declare_token(token) for token in broken]
    say(event="ready")
    number = 0
    while True:
        for size in (0, 1, 16, 17, 32, 34, 300):
            publisher.put(cdr("attachment"), attachment=(good * 10)[:size])
        publisher.put(cdr("no attachment"))
        publisher.put(cdr("gid of 255"), attachment=good[:16] + b"\xff" + good[17:])
        for payload in (b"", b"\0", b"\0\1\0", b"\7\7\0\0abcd", bytes(100)[1:] + b"\xff"):
            if payload[:2] != b"\0\0":
                publisher.put(payload, attachment=endpoint.attachment())
        publisher.delete(attachment=b"x")
        publisher.put(cdr(stamped(number, "good")), attachment=endpoint.attachment())
        number += 1
        time.sleep(0.01)
    return tokens


def misanswer(args):
    """Serves a switch with broken responses before the good one, and calls others with broken requests."""
    served, *called = args.service
    session = ZenohSession.get_instance("127.0.0.1", args.port).session
    node = NodeEntity(0, str(session.info.zid()), 1, args.node, args.namespace)
    dds = "std_srvs::srv::dds_::SetBool_"
    type_hash = compute_service_type_hash(SET_BOOL["srv_type"], SET_BOOL["request_definition"], SET_BOOL["response_definition"])
    key = lambda service: topic_keyexpr(0, service, dds, type_hash)
    endpoint = EndpointEntity(node, 2, EntityKind.SERVICE, served, dds, type_hash, "::,10:,:,:,,")
    tokens = [node_liveliness_keyexpr(node), endpoint_liveliness_keyexpr(endpoint)]

    def answer(query):
        on, attachment = query.payload.to_bytes()[4], query.attachment.to_bytes()
        message = f"{served} is {'on' if on else 'off'}".encode() + b"\0"
        good = b"\0\1\0\0" + bytes([on, 0, 0, 0]) + len(message).to_bytes(4, "little") + message
        other = (int.from_bytes(attachment[:8], "little") + 7).to_bytes(8, "little") + attachment[8:]
        wrong = b"\0\1\0\0" + bytes([1 - on, 0, 0, 0]) + bytes(4)
        query.reply_err(b"broken")
        for size in (0, 5, 17, 32):
            query.reply(key(served), wrong, attachment=attachment[:size])
        query.reply(key(served), wrong)
        query.reply(key(served), wrong, attachment=other)
        query.reply(key(served), b"\7\7", attachment=attachment)
        query.reply(key(served), good, attachment=attachment)

    alive = [session.declare_queryable(key(served), answer, complete=True)]
    alive += [session.liveliness().declare_token(token) for token in tokens]
    say(event="ready")
    attachment = (1).to_bytes(8, "little") + bytes(8) + b"\x10" + bytes(16)
    while True:
        for service in called:
            options = {"target": zenoh.QueryTarget.ALL_COMPLETE, "timeout": 1}
            session.get(key(service), lambda reply: None, **options)
            for payload, size in ((b"\0\1\0\0\1", 0), (b"\0\1\0\0\1", 32), (b"", 33), (b"\0\1", 33), (b"\0\1\0\0", 33)):
                session.get(key(service), lambda reply: None, payload=payload, attachment=attachment[:size], **options)
        time.sleep(0.05)


def switch(args):
    (service,) = args.service

    def answer(request):
        message = f"{service} is {'on' if request.data else 'off'}"
        return server.response_msg_class(success=request.data, message=message)

    server = ROS2ServiceServer(service_name=service, callback=answer, **SET_BOOL, **common(args))
    say(event="ready")
    return server


def set(args):
    clients = {it: ROS2ServiceClient(service_name=it, timeout=30, **SET_BOOL, **common(args)) for it in args.service}
    for service, client in clients.items():
        for value in [True, False]:
            while (response := client.call(data=value)) is None:
                time.sleep(0.1)
            say(event="response", service=service, success=response.success, message=response.message)
    return clients


logging.disable(logging.CRITICAL)
args = arguments()
alive = globals()[args.verb](args)
while True:
    time.sleep(60)
