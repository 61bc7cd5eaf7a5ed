"""The `grasp` workload: a depth and a color image of a tray, and ranked grasps.

The edge finds antipodal grasps analytically: contact points at depth edges, opposite within the
friction cone, with room for the fingers. It is not Dex-Net: no network scores the grasps.
`grasp-small` is the same with half the width and height.
"""

import cv2
import numpy as np

from cdr import digest
from geometry import quaternion
from messages import Image, PoseArray

REQUESTS = {"/grasp/depth": Image, "/grasp/color": Image}
REPLY = ("/grasp/grasps", PoseArray)
OPEN_LOOP = False
FRAME = "camera_color_optical_frame"
#: Pixels of the full size, and the focal length in such pixels.
WIDTH, HEIGHT, FOCAL = 1032, 772, 1122.0
TRAY = 0.8  # metres from the camera
MOST_GRASPS = 20

FRICTION = 0.5
#: Pairs of edge points that are examined.
PAIRS = 200_000
#: A depth edge rises by as many metres per pixel of the full size.
EDGE = 0.004
#: Contacts' distances in full-size pixels; a gripper opens by 110 pixels, 8 cm on the tray.
NARROWEST, WIDEST = 8.0, 110.0
#: A finger's distance outside its contact, and of grasps that count as different, in pixels.
FINGER, APART = 8.0, 14.0
#: A finger needs as much depth below the grasp, and more does not make a grasp better.
SHALLOWEST, DEEPEST = 0.012, 0.05
#: An object's pixel has color channels that differ by as much; the tray is gray.
SATURATION = 40


class Robot:
    def __init__(self, options):
        self.seed, self.scale = options.seed, options.scale

    def request(self, number):
        depth, color = tray(np.random.default_rng([self.seed, number + 1]), self.scale)
        return [Image(number, FRAME, "32FC1", depth), Image(number, FRAME, "rgb8", color)]

    def result(self, replies):
        poses = [replies[number].poses for number in sorted(replies)]
        return {
            "grasps": sum(map(len, poses)),
            "digest": digest(np.ascontiguousarray(grasps) for grasps in poses),
        }


class Edge:
    def __init__(self, options):
        # The first call of OpenCV's filters takes longer than the next ones.
        grasps(*tray(np.random.default_rng(0), options.scale), seed=0)

    def compute(self, depth, color):
        seed = depth.number % 2**32
        return PoseArray(depth.number, FRAME, grasps(depth.pixels, color.pixels, seed))

    def answer_warm_up(self, number):
        return PoseArray(number, FRAME, np.zeros((0, 7)))


def tray(rng, scale):
    """Draws boxes and ellipses that lie on a tray, with the noise of a depth camera."""
    width, height = int(WIDTH * scale), int(HEIGHT * scale)
    depth = np.full((height, width), TRAY, np.float32)
    color = np.full((height, width, 3), 120, np.uint8)
    for _ in range(14):
        center = rng.uniform([0.15 * width, 0.15 * height], [0.85 * width, 0.85 * height])
        size, angle = rng.uniform(25, 90, 2) * scale, rng.uniform(0, 180)
        mask = np.zeros((height, width), np.uint8)
        outline = (tuple(map(float, center)), tuple(map(float, size)), float(angle))
        if rng.random() < 0.5:
            cv2.fillPoly(mask, [cv2.boxPoints(outline).astype(np.int32)], 1)
        else:
            cv2.ellipse(mask, outline, 1, -1)
        top = np.float32(TRAY - rng.uniform(0.02, 0.1))
        visible = (mask > 0) & (depth > top)
        depth[visible] = top
        color[visible] = rng.permutation([220, rng.integers(0, 120), rng.integers(0, 120)])
    depth += np.float32(0.0006) * rng.standard_normal(depth.shape, np.float32)
    noise = rng.integers(-8, 9, color.shape, dtype=np.int16)
    return depth, np.clip(color + noise, 0, 255).astype(np.uint8)


def grasps(depth, color, seed):
    """Returns the best grasps first, [count, 7]: the closing direction is x, the approach z."""
    scale = depth.shape[1] / WIDTH
    smooth = cv2.GaussianBlur(depth, (0, 0), 2 * scale)
    points, normals = edges(smooth, color, scale)
    if not len(points):
        return np.zeros((0, 7))
    first, second, axis = opposite_pairs(points, normals, scale, np.random.default_rng(seed))
    a, b = points[first], points[second]
    center = (a + b) / 2
    tip = depth_at(smooth, center)
    fingers = [a - axis * FINGER * scale, b + axis * FINGER * scale]
    room = np.minimum(*(depth_at(smooth, finger) for finger in fingers)) - tip
    straight = np.minimum(-dot(normals[first], axis), dot(normals[second], axis))
    score = straight * np.minimum(room, DEEPEST) / DEEPEST
    score[room < SHALLOWEST] = 0
    chosen = best_apart(score, center, APART * scale)
    height, width = depth.shape
    offset = (center - [width / 2, height / 2]) / (FOCAL * scale)
    return np.array(
        [pose(np.append(offset[n], 1.0) * tip[n], axis[n]) for n in chosen]
    ).reshape(-1, 7)


def edges(smooth, color, scale):
    """Pixels of depth edges at objects, and the outward normal of each, in the image plane."""
    # A Sobel filter weighs 8 pixel distances.
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_32F, *order) / 8 for order in ((1, 0), (0, 1))])
    slope = np.hypot(*gradient)
    # Columns before rows: OpenCV reduces a [pixels, 3] array to its rows' extremes.
    flat = np.ascontiguousarray(color).reshape(-1, 3)
    spread = cv2.reduce(flat, 1, cv2.REDUCE_MAX) - cv2.reduce(flat, 1, cv2.REDUCE_MIN)
    objects = (spread > SATURATION).astype(np.uint8).reshape(slope.shape)
    near_object = cv2.dilate(objects, np.ones((5, 5), np.uint8)) > 0
    ys, xs = np.nonzero((slope > EDGE / scale) & near_object)
    normals = (gradient[:, ys, xs] / slope[ys, xs]).T
    return np.stack([xs, ys], 1).astype(np.float32), normals


def opposite_pairs(points, normals, scale, rng):
    """Random pairs of points within the friction cones of each other, and the line's direction."""
    first, second = rng.integers(0, len(points), (2, PAIRS))
    line = points[second] - points[first]
    distance = np.hypot(line[:, 0], line[:, 1])
    near = (distance > NARROWEST * scale) & (distance < WIDEST * scale)
    first, second = first[near], second[near]
    axis = line[near] / distance[near][:, None]
    cone = np.cos(np.arctan(FRICTION))
    stable = (-dot(normals[first], axis) > cone) & (dot(normals[second], axis) > cone)
    return first[stable], second[stable], axis[stable]


def best_apart(score, center, apart):
    """Numbers of the best grasps that are at least `apart` pixels from every better one."""
    chosen = []
    # Stable, so that equal scores keep the order in which the pairs were drawn.
    for number in np.argsort(-score, kind="stable"):
        if score[number] <= 0 or len(chosen) == MOST_GRASPS:
            break
        if not chosen or np.hypot(*(center[chosen] - center[number]).T).min() >= apart:
            chosen.append(number)
    return chosen


def depth_at(depth, points):
    last = np.array(depth.shape[::-1]) - 1
    columns, rows = np.clip(np.rint(points).astype(int), 0, last).T
    return depth[rows, columns]


def dot(a, b):
    return (a * b).sum(1)


def pose(position, axis):
    x = np.array([axis[0], axis[1], 0.0])
    z = np.array([0.0, 0.0, 1.0])
    return np.concatenate([position, quaternion(np.stack([x, np.cross(z, x), z], 1))])
