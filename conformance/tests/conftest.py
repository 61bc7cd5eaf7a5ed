"""The vectors of `docs/vectors`, with byte strings for hexadecimal text where a test wants them."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "conformance"))


@pytest.fixture(scope="session")
def vectors():
    return lambda stem: json.loads((ROOT / "docs/vectors" / f"{stem}.json").read_text())
