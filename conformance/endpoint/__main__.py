"""Runs the endpoint against a switch: `python -m endpoint exchange | refusals`."""

import argparse
import asyncio
import sys
from pathlib import Path

from .exchange import exchange
from .refusals import refusals


def main() -> int:
    parser = argparse.ArgumentParser(prog="endpoint", description=__doc__)
    parser.add_argument("verb", choices=["exchange", "refusals"])
    parser.add_argument("--switch", required=True, metavar="HOST:PORT", help="address of the switch")
    parser.add_argument("--folder", required=True, type=Path, help="id.pem, and cards and rights as README.md lists")
    parser.add_argument("--count", type=int, default=1000, help="messages in each direction")
    parser.add_argument("--lose", type=int, default=0, metavar="N", help="lose each Nth data frame, in both directions")
    options = parser.parse_args()
    host, _, port = options.switch.rpartition(":")
    if options.verb == "exchange":
        return asyncio.run(exchange(host.strip("[]"), int(port), options.folder, options.count, options.lose))
    return asyncio.run(refusals(host.strip("[]"), int(port), options.folder))


sys.exit(main())
