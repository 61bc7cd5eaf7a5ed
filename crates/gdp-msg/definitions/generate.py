#!/usr/bin/env python3
"""Writes the definitions that gdp-msg embeds, one text for each package, from where ROS installs them.

    generate.py ros1|ros2 SHARE [PACKAGE...]

SHARE is a folder of packages (`PACKAGE/msg/*.msg`, `srv`, `action`). Only what means something is kept: no comments, no blank
lines. README.md says from where the texts here came.
"""

import pathlib
import re
import sys

KINDS = ("msg", "srv", "action")


def meaning(dialect, line):
    """The line without its comment; in ROS 1 a string constant has none."""
    line = line.replace("\t", " ")
    if dialect == "ros1" and re.match(r"\s*string\s+\w+\s*=", line):
        return line.strip()
    return " ".join(line.split("#")[0].split()) if '"' not in line and "'" not in line else line.split("#")[0].strip()


def package_text(dialect, package):
    sections = []
    for kind in KINDS:
        for file in sorted((package / kind).glob(f"*.{kind}")):
            lines = (meaning(dialect, line) for line in file.read_text(encoding="utf-8").splitlines())
            body = "".join(f"{line}\n" for line in lines if line)
            sections.append(f"=== {kind}/{file.stem}\n{body}")
    return "".join(sections)


def main():
    dialect, share, packages = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3:]
    into = pathlib.Path(__file__).parent / dialect
    into.mkdir(exist_ok=True)
    for package in sorted(share.iterdir()):
        if packages and package.name not in packages:
            continue
        if text := package_text(dialect, package):
            (into / f"{package.name}.txt").write_text(text, encoding="utf-8")
            print(package.name)


if __name__ == "__main__":
    main()
