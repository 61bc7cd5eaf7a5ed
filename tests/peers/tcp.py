"""A talker or listener over a TCP connection, as a measure for what the kernel carries. See README.md."""

import argparse
import json
import os
import socket
import ssl
import struct
import sys
import time
import zlib

# Length of sequence number, clock and checksum in a message, with the spaces behind them.
HEAD = 43
PORT = 7448


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["talk", "listen"])
    p.add_argument("--peer", default="", help="the listener's address; the listener listens at every address")
    p.add_argument("--depth", type=int, help="ignored: TCP drops nothing")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--size", type=int, default=64)
    p.add_argument("--text", default="hello from the robot")
    p.add_argument("--key", help="the listener's private key, PEM: use TLS")
    p.add_argument("--certificate", help="the certificate of that key, which the talker trusts, PEM")
    p.add_argument("--gate", help="send warm-up messages, numbered -1, until this file exists")
    return p.parse_args()


args = arguments()


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def connect():
    deadline = time.monotonic() + 30
    while True:
        try:
            return socket.create_connection((args.peer, PORT))
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def secured(connection):
    """Returns the connection, with TLS 1.3 if there is a certificate."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if not args.certificate:
        return connection
    listens = args.verb == "listen"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if listens else ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    if listens:
        context.load_cert_chain(args.certificate, args.key)
    else:
        context.load_verify_locations(args.certificate)
    return context.wrap_socket(connection, server_side=listens, server_hostname=None if listens else args.peer)


def talk():
    connection = secured(connect())
    say(event="matched")
    room = max(0, args.size - HEAD)
    filler = ((args.text + " ") * (room // (len(args.text) + 1) + 1))[:room].encode()
    crc = zlib.crc32(filler)

    def write(sequence):
        head = f"{sequence:010d} {time.monotonic_ns():020d} {crc:010d} ".encode()
        connection.sendall(b"".join([struct.pack("!I", len(head) + len(filler)), head, filler]))

    while args.gate and not os.path.exists(args.gate):
        write(-1)
        time.sleep(1 / args.rate)
    start = time.monotonic()
    sequence = 0
    while args.count == 0 or sequence < args.count:
        wait = start + sequence / args.rate - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        write(sequence)
        sequence += 1
    say(event="done", sent=sequence)
    while True:
        time.sleep(3600)


def read(connection, length):
    """Returns this many bytes, or None at the end of the connection."""
    buffer = memoryview(bytearray(length))
    filled = 0
    while filled < length:
        count = connection.recv_into(buffer[filled:])
        if count == 0:
            return None
        filled += count
    return buffer


def listen():
    listener = socket.create_server(("", PORT))
    say(event="ready")
    connection = secured(listener.accept()[0])
    while head := read(connection, 4):
        body = read(connection, struct.unpack("!I", head)[0])
        if body is None:
            break
        now = time.monotonic_ns()
        sequence, clock, crc = bytes(body[: HEAD - 1]).split(b" ")
        intact = zlib.crc32(body[HEAD:]) == int(crc)
        say(event="message", seq=int(sequence), latency_ns=now - int(clock), bytes=len(body), intact=intact)
    while True:
        time.sleep(3600)


talk() if args.verb == "talk" else listen()
