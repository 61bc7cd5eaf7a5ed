"""Reports events on standard output, one JSON object per line.

ORB-SLAM3 and OMPL print from C++ to file descriptor 1. `Report` keeps the descriptor for itself and
points number 1 to standard error, so that a reader of standard output gets events only.
"""

import json
import os
import sys


class Report:
    def __init__(self):
        sys.stdout.flush()
        self.out = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)

    def __call__(self, event, **fields):
        self.out.write(json.dumps({"event": event, **fields}) + "\n")
        self.out.flush()
