"""The `motion` workload: a house as collision meshes and a goal, and a path through the house.

The robot's body is a rigid L of two boxes that flies: its configurations are SE(3). The edge plans
with RRT-Connect (OMPL) and checks collisions between meshes (FCL).

The same request gives the same path, bit for bit: the planner's seed is computed from the request,
and planning ends after a number of collision checks, not after a time.
"""

import numpy as np

import house
from cdr import digest
from messages import Marker, Path, PoseStamped

REQUESTS = {"/planner/scene": Marker, "/planner/goal": PoseStamped}
REPLY = ("/planner/path", Path)
OPEN_LOOP = False
FRAME = "map"
#: Planning fails after as many collision checks. Typical requests need a tenth of it.
MOST_CHECKS = 200_000
#: Distance of collision checks along a motion, as a fraction of the space's extent (0.05 m).
RESOLUTION = 0.003
#: Longest motion that the tree grows by at once.
RANGE = 1.5
BODY = [([-0.35, -0.1, -0.1], [0.35, 0.1, 0.1]), ([0.15, -0.1, 0.1], [0.35, 0.1, 0.5])]
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class Robot:
    def __init__(self, options):
        self.seed = options.seed

    def request(self, number):
        rng = np.random.default_rng([self.seed, number + 1])
        points = house.house(rng)
        first, last = rng.choice(len(house.ROOMS), 2, replace=False)
        start, goal = (
            np.concatenate([house.middle(room), [height], LEVEL])
            for room, height in zip((first, last), rng.uniform(0.8, 1.6, 2))
        )
        return [
            Marker(number, FRAME, self.seed, start, points),
            PoseStamped(number, FRAME, goal),
        ]

    def result(self, replies):
        paths = [replies[number].poses for number in sorted(replies)]
        return {
            "solved": sum(len(path) > 0 for path in paths),
            "length": [length(path) for path in paths],
            "digest": digest(np.ascontiguousarray(path) for path in paths),
        }


class Edge:
    def __init__(self, options):
        # Only the edge's machine needs the libraries.
        from planner import Planner

        self.planner = Planner(BODY, RESOLUTION, RANGE, MOST_CHECKS)

    def compute(self, scene, goal):
        # OMPL's seed is a positive number of 32 bits.
        seed = (scene.seed * 1_000_003 + scene.number) % (2**31 - 1) + 1
        path = self.planner.plan(scene.points, scene.start, goal.pose, seed)
        return Path(scene.number, FRAME, path)

    def answer_warm_up(self, number):
        return Path(number, FRAME, np.zeros((0, 7)))


def length(path):
    """Metres that the body's origin moves."""
    return float(np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).sum()) if len(path) else 0.0
