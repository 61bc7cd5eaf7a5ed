#!/bin/sh
# What maturin starts in place of cargo: it names the library that the tests built.
exec cat "$GDP_TEST_ARTIFACT"
