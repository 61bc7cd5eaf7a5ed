"""The workloads by name. Each is a module; README.md, "Workloads", describes what it has."""

import argparse
import importlib

#: Name on the command line: module, and the factor by which its images are scaled.
WORKLOADS = {
    "slam": ("slam", 1.0),
    "motion": ("motion", 1.0),
    "grasp": ("grasp", 1.0),
    "grasp-small": ("grasp", 0.5),
    "echo": ("echo", 1.0),
}


def parser(description):
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("workload", choices=WORKLOADS)
    parser.add_argument("--data", help="the folder that prepare.py filled; slam needs it")
    return parser


def load(options):
    """Imports the workload's module, and puts the images' scale into the options."""
    name, options.scale = WORKLOADS[options.workload]
    if name == "slam" and not options.data:
        raise SystemExit("slam needs --data, the folder that prepare.py filled")
    return importlib.import_module(name)
