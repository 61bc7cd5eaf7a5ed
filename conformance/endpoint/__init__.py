"""A second endpoint of the Global Data Plane, written from `docs/wire-format/` alone."""
