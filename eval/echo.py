"""The `echo` workload: an image of N bytes and its return, without computing."""

import numpy as np

from messages import Image

REQUESTS = {"/echo/request": Image}
REPLY = ("/echo/reply", Image)
OPEN_LOOP = False


class Robot:
    def __init__(self, options):
        self.options = options

    def request(self, number):
        rng = np.random.default_rng([self.options.seed, number + 1])
        pixels = rng.integers(0, 256, (1, self.options.bytes), dtype=np.uint8)
        return [Image(number, "echo", "mono8", pixels)]

    def result(self, replies):
        return {"echoed": len(replies)}


class Edge:
    def __init__(self, options):
        pass

    def compute(self, image):
        return image

    def answer_warm_up(self, number):
        return Image(number, "echo", "mono8", np.zeros((1, 1), np.uint8))
