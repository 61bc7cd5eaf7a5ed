"""Plans the path of a rigid body among triangles, reproducibly (OMPL and FCL)."""

import fcl
import numpy as np
from ompl import base, geometric, util

import house


class Planner:
    """`body` is a list of boxes (two corners each). `plan` fails after `most_checks` checks."""

    def __init__(self, body, resolution, longest, most_checks):
        # OMPL calls it an error to set the seed again; see `plan`.
        util.setLogLevel(util.LogLevel.LOG_NONE)
        points = np.concatenate([house.triangles(*box) for box in body])
        self.body = fcl.CollisionObject(mesh(points))
        self.resolution, self.longest, self.most_checks = resolution, longest, most_checks

    def plan(self, points, start, goal, seed):
        """Returns poses [count, 7] from `start` to `goal`, or [0, 7] if no path was found."""
        # Generators of random numbers get their seeds, in the order in which they are made, from
        # one generator that this call seeds. So all of OMPL's objects are made anew after it.
        util.RNG.setSeed(seed)
        scene = fcl.CollisionObject(mesh(points))
        space = base.SE3StateSpace()
        space.setBounds(bounds(points))
        setup = geometric.SimpleSetup(space)
        checks = Checks(scene, self.body)
        setup.setStateValidityChecker(checks.valid)
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(self.resolution)
        setup.setStartAndGoalStates(to_state(space, start), to_state(space, goal))
        planner = geometric.RRTConnect(information)
        planner.setRange(self.longest)
        setup.setPlanner(planner)
        exhausted = base.PlannerTerminationCondition(lambda: checks.count > self.most_checks)
        setup.solve(exhausted)
        if not setup.haveExactSolutionPath():
            return np.zeros((0, 7))
        path = setup.getSolutionPath()
        # `simplifySolution` would work until a time is up. These end after a number of attempts.
        simplifier = geometric.PathSimplifier(information)
        simplifier.reduceVertices(path, 30, 30)
        simplifier.collapseCloseVertices(path, 30, 30)
        return np.array([from_state(state) for state in path.getStates()])


class Checks:
    """Checks states for collisions, and counts the checks."""

    def __init__(self, scene, body):
        self.scene, self.body, self.count = scene, body, 0
        self.request = fcl.CollisionRequest()

    def valid(self, state):
        self.count += 1
        x, y, z, qx, qy, qz, qw = from_state(state)
        self.body.setTransform(fcl.Transform(np.array([qw, qx, qy, qz]), np.array([x, y, z])))
        return fcl.collide(self.scene, self.body, self.request, fcl.CollisionResult()) == 0


def mesh(points):
    """An FCL mesh of the triangles with the corners `points`, [3 * triangles, 3]."""
    model = fcl.BVHModel()
    faces = np.arange(len(points)).reshape(-1, 3)
    model.beginModel(len(points), len(faces))
    model.addSubModel(np.ascontiguousarray(points), faces)
    model.endModel()
    return model


def bounds(points):
    limits = base.RealVectorBounds(3)
    for axis in range(3):
        limits.setLow(axis, float(points[:, axis].min()))
        limits.setHigh(axis, float(points[:, axis].max()))
    return limits


def to_state(space, pose):
    x, y, z, qx, qy, qz, qw = map(float, pose)
    state = space.allocState()
    state.setXYZ(x, y, z)
    rotation = state.rotation()
    rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw
    return state


def from_state(state):
    q = state.rotation()
    return state.getX(), state.getY(), state.getZ(), q.x, q.y, q.z, q.w
