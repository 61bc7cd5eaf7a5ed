"""Vectors of frames, link keys, sealed segments, wrapped keys and feedback."""

import pytest

from endpoint import feedback, frames, keys, segments
from endpoint.encoding import Refused, compressed, derive_name, metadata_digest, private_key
from endpoint.feedback import Channel, Feedback

OTHER_KEY = bytes(16)


def receiver(vector, accepted=()):
    """Returns a receiver with the vector's key for key phase 0 and none for phase 1."""
    link = frames.Receiver(vector["link_id"], [bytes.fromhex(vector["key"]), OTHER_KEY])
    for count in accepted:
        link.accept(count)
    return link


def test_data_headers(vectors):
    for vector in vectors("header")["data"]:
        header = bytes.fromhex(vector["header"])
        frame = frames.Frame(
            frames.DATA, bytes.fromhex(vector["destination"]), bytes.fromhex(vector["source"]),
            bytes(vector["payload_length"]), vector["flags"], vector["hop_limit"], vector["egress_set"],
            bytes.fromhex(vector["egress_bits"]), vector["reserved"],
        )
        key = bytes.fromhex(vector["key"])
        sealed = frame.seal(key, vector["link_id"], vector["count"])
        assert sealed[:96] == header and sealed[16:24].hex() == vector["tag"]
        link = receiver(vector, [vector["count"] - 1] if vector["count"] > 2**32 else [])
        if vector["count"] == 2**32:
            link.highest = 2**32 - 1
        link.keys = [key, key]
        assert link.open(sealed) == frame
        assert link.highest == vector["count"]


def test_errors(vectors):
    for vector in vectors("header")["errors"]:
        link = receiver(vector)
        reason, mtu, count = frames.error_of(link.open(bytes.fromhex(vector["error"])))
        assert reason == frames.ERRORS[vector["code"]] and mtu == vector["mtu"]
        assert count == int.from_bytes(bytes.fromhex(vector["dropped"])[12:16])
        assert link.highest == vector["count"]


def test_echoes(vectors):
    for vector in vectors("header")["echoes"]:
        key, link_id, count = bytes.fromhex(vector["key"]), vector["link_id"], vector["count"]
        question = frames.echo(bytes.fromhex(vector["cookie"]))
        assert question.seal(key, link_id, count).hex() == vector["question"]
        assert frames.echo_answer(question).seal(key, link_id, count).hex() == vector["answer"]


def test_probes(vectors):
    for vector in vectors("header")["probes"]:
        frame = receiver(vector).open(bytes.fromhex(vector["frame"]))
        assert frame.kind == frames.PROBE and frame.payload.hex() == vector["cookie"]
        assert int.from_bytes(frame.egress_bits) == 1 << vector["egress_bit"]


def test_dropped_frames(vectors):
    for vector in vectors("header")["refused"]:
        link = receiver(vector, vector["accepted"])
        with pytest.raises(frames.Dropped) as dropped:
            link.open(bytes.fromhex(vector["frame"]))
        assert dropped.value.code == vector["counter"], vector["description"]


def test_link_keys(vectors):
    for vector in vectors("link_keys")["vectors"]:
        generations = frames.link_secrets(bytes.fromhex(vector["generations"][0]["secret"]))
        for expected, (secret, key) in zip(vector["generations"], generations, strict=False):
            assert secret.hex() == expected["secret"] and key.hex() == expected["key"]
            assert expected["generation"] & 1 == expected["key_phase"]


@pytest.fixture
def sealed(vectors):
    """Returns the vectors, the keys of their session, and the writer's signing key."""
    file = vectors("segment")
    given = [bytes.fromhex(file[field]) for field in ("epoch_key", "session", "name", "writer")]
    session = segments.SessionKeys(*given)
    assert session.key.hex() == file["session_key"] and session.commitment.hex() == file["commitment"]
    signing_key = private_key(bytes([1]) * 32)
    assert compressed(signing_key.public_key()).hex() == file["verify_key"]
    return file, session, signing_key


def messages_of(vector) -> list[segments.Message]:
    return [message_of(message, int(vector["timestamp_ns"])) for message in vector["messages"]]


def message_of(message: dict, timestamp: int) -> segments.Message:
    extensions = []
    if reply := message["in_reply_to"]:
        extensions.append((segments.IN_REPLY_TO, bytes.fromhex(reply["session"]) + reply["sequence"].to_bytes(8)))
    if message["origin"]:
        extensions.append((segments.ORIGIN, bytes.fromhex(message["origin"])))
    if message["service"]:
        extensions.append((segments.SERVICE, bytes.fromhex(message["service"])))
    return segments.Message(timestamp, message["encoding"], bytes.fromhex(message["body"]), tuple(extensions))


def pack(sealed: list[bytes], room: int) -> list[bytes]:
    """Packs segments into payloads greedily."""
    payloads = [b""]
    for segment in sealed:
        if len(payloads[-1]) + len(segment) > room:
            payloads.append(b"")
        payloads[-1] += segment
    return payloads


def seal(vector, session, signing_key, epoch: int, cut: int = 0) -> list[bytes]:
    messages, room, first = messages_of(vector), vector["max_payload"], vector["first_sequence"]
    if "bundle" in vector["description"]:
        drafts = [segments.draft_bundle(session, messages, epoch, first)]
    else:
        proof = segments.PROOF + 32 * (len(messages) - 1).bit_length()
        drafts = [
            segments.draft_message(session, message, epoch, first + i, room, cut, proof)
            for i, message in enumerate(messages)
        ]
    proofs = segments.proofs([draft.leaf for draft in drafts], signing_key)
    return pack([s for draft, proof in zip(drafts, proofs, strict=True) for s in draft.seal(session, proof)], room)


def open_payloads(session, payloads: list[bytes], verify_key) -> list[segments.Message]:
    opened, plains = [], []
    for payload in payloads:
        for head, clear, ciphertext in segments.split(payload):
            plains.append(session.open(clear, ciphertext))
            if head.kind in (segments.LAST, segments.BUNDLE):
                opened += segments.open_whole(session, head, clear, plains, verify_key)
                plains = []
    return opened


def test_sealed_messages(sealed):
    file, session, signing_key = sealed
    for vector in file["vectors"]:
        payloads = [bytes.fromhex(payload) for payload in vector["payloads"]]
        assert open_payloads(session, payloads, signing_key.public_key()) == messages_of(vector), vector["description"]
        assert seal(vector, session, signing_key, file["epoch"]) == payloads, vector["description"]


def test_a_message_cut_anew(sealed):
    file, session, signing_key = sealed
    anew = {**file["vectors"][0], **file["cut_anew"]}
    payloads = [bytes.fromhex(payload) for payload in anew["payloads"]]
    assert seal(anew, session, signing_key, file["epoch"], cut=1) == payloads
    assert open_payloads(session, payloads, signing_key.public_key()) == messages_of(file["vectors"][0])


def test_a_heartbeat(sealed):
    file, session, signing_key = sealed
    beat = file["heartbeat"]
    (payload,), stamp = beat["payloads"], int(beat["timestamp_ns"])
    made = segments.seal_heartbeat(
        session, file["epoch"], beat["number"], beat["next"], beat["oldest"], stamp, signing_key
    )
    assert made.hex() == payload
    ((head, clear, ciphertext),) = segments.split(made)
    assert (head.index, head.sequence) == (beat["number"], beat["next"])
    plain = session.open(clear, ciphertext)
    assert segments.open_heartbeat(session, clear, plain, signing_key.public_key()) == (stamp, beat["oldest"])


def test_segments_of_later_releases(sealed):
    file, session, signing_key = sealed
    for vector in file["later_releases"]:
        try:
            (message,) = open_payloads(session, [bytes.fromhex(vector["payload"])], signing_key.public_key())
            assert vector["refused"] is None and message.body.hex() == vector["body"], vector["description"]
        except Refused as refused:
            assert refused.code == vector["refused"], vector["description"]


def test_a_changed_segment_is_refused(sealed):
    file, session, signing_key = sealed
    payload = bytearray.fromhex(file["vectors"][0]["payloads"][0])
    payload[-20] ^= 1
    with pytest.raises(Refused):
        open_payloads(session, [bytes(payload)], signing_key.public_key())


@pytest.fixture
def pair(vectors):
    file = vectors("keys")
    signing = {role: private_key(bytes.fromhex(file[role]["signing_key"])) for role in ("reader", "writer")}
    return file, signing


def test_wrapped_keys(pair):
    file, signing = pair
    box, reader = file["key_box"], keys.box_key(signing["reader"])
    for role in ("reader", "writer"):
        assert keys.box_public(signing[role]).hex() == file[role]["box_public"]
        assert derive_name(compressed(signing[role].public_key()), metadata_digest({"kind": "proxy"})).hex() == (
            file[role]["name"]
        )
    names = [bytes.fromhex(text) for text in (box["name"], file["writer"]["name"], file["reader"]["name"])]
    info = keys.wrap_info(*names, box["epoch"])
    assert info.hex() == box["info"]
    epoch_key = bytes.fromhex(box["epoch_key"])
    assert keys.unwrap(bytes.fromhex(box["sealed"]), reader, info) == epoch_key
    again = keys.wrap(epoch_key, keys.box_public(signing["reader"]), info)
    assert len(again) == 113 and keys.unwrap(again, reader, info) == epoch_key
    with pytest.raises(Refused):
        keys.unwrap(again, keys.box_key(signing["writer"]), info)


def channels(pair) -> dict[str, Channel]:
    file, signing = pair
    names = {role: bytes.fromhex(file[role]["name"]) for role in signing}
    session, made = bytes.fromhex(file["feedback"]["session"]), {}
    for own, peer in (("reader", "writer"), ("writer", "reader")):
        shared = keys.pair_key(
            keys.box_key(signing[own]), names[own], bytes.fromhex(file[peer]["box_public"]), names[peer]
        )
        made[own] = Channel(shared, names[own], names[peer], session)
    return made


def test_feedback(pair):
    file, both = pair[0]["feedback"], channels(pair)
    reader, writer = both["reader"], both["writer"]
    for kind in ("hello", "welcome", "report", "nack", "gone", "two"):
        payload, plain = bytes.fromhex(file[kind]["payload"]), bytes.fromhex(file[kind]["plaintext"])
        messages = feedback.parse(plain)
        assert b"".join(map(feedback.pack, messages)) == plain, kind
        assert writer.open(payload) == messages, kind
        reader.counter = int.from_bytes(payload[9:17]) - 1
        assert reader.seal(*messages) == payload, kind
        with pytest.raises(Refused):
            writer.open(payload)


@pytest.mark.parametrize(
    "ranges", [[], [(5, 0, 3, 0)], [(5, 0, 2, 4), (5, 0, 3, 1)], [(6, 0, 0, 1), (5, 0, 0, 1)], [(5, 0, 2, 2**32 - 1)]]
)
def test_refused_ranges(ranges):
    nack = feedback.pack(Feedback(feedback.NACK, bytes(32), (bytes(16), 0, 0, 0, ranges)))
    with pytest.raises(Refused):
        feedback.parse(nack)
