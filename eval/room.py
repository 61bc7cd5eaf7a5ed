"""Renders what an RGB-D camera sees on a closed path through a furnished, textured room."""

import itertools

import cv2
import numpy as np

#: The focal length is that of a wide RGB-D camera (77 degrees).
WIDTH, HEIGHT, FOCAL = 640, 480, 400.0
#: Depth images count millimetres, as ROS drivers publish 16UC1.
DEPTH_FACTOR = 1000.0
#: Pixels of a texture's side, and on a metre of wall: 6 m fit.
TEXTURE, TEXTURE_PER_METRE = 1024, 170.0
#: Corners in metres; x to the right, y down, z forward. The first is the room, seen from inside.
BOXES = np.array(
    [
        [[0.0, 0.0, 0.0], [6.0, 3.0, 6.0]],
        [[0.0, 1.2, 1.0], [0.5, 3.0, 2.4]],
        [[2.2, 2.0, 5.3], [4.0, 3.0, 6.0]],
        [[5.4, 0.8, 3.4], [6.0, 3.0, 4.4]],
        [[3.6, 1.8, 0.0], [5.2, 3.0, 0.6]],
    ],
    np.float32,
)


class Room:
    """`render` adds the camera's noise from the generator that was passed in."""

    def __init__(self, rng):
        self.textures = [[texture(rng) for _ in range(6)] for _ in BOXES]
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = [(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)]
        self.rays = np.stack(rays, -1).astype(np.float32)

    def render(self, rotation, position, rng):
        """Returns an rgb8 and a 16UC1 image. `rotation` has the camera's axes as columns."""
        position = position.astype(np.float32)
        directions = self.rays @ rotation.T.astype(np.float32)
        color = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        # A ray's parameter is its depth, because rays have length 1 along the optical axis.
        depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
        for number, box in enumerate(BOXES):
            part = np.s_[:, :] if number == 0 else visible_part(box, rotation, position)
            if part:
                self.draw(number, box, position, directions[part], color[part], depth[part])
        noise = rng.standard_normal((HEIGHT, WIDTH, 4), np.float32)
        color = color + 3 * noise[..., :3]
        depth = depth + 0.0015 * depth**2 * noise[..., 3]
        millimetres = np.clip(depth * DEPTH_FACTOR, 0, 65535).astype(np.uint16)
        return np.clip(color, 0, 255).astype(np.uint8), millimetres

    def draw(self, number, box, position, directions, color, depth):
        """Draws the box where it is nearer than what `depth` has (the slab method)."""
        enter, leave, nearest, farthest = -np.inf, np.inf, 0, 0
        for axis in range(3):
            with np.errstate(divide="ignore"):
                inverse = 1 / directions[..., axis]
            a, b = ((corner[axis] - position[axis]) * inverse for corner in box)
            near, far = np.minimum(a, b), np.maximum(a, b)
            nearest = np.where(near > enter, axis, nearest)
            farthest = np.where(far < leave, axis, farthest)
            enter, leave = np.maximum(enter, near), np.minimum(leave, far)
        if number == 0:
            distance, normals, hit = leave, farthest, np.ones_like(depth, bool)
        else:
            distance, normals = enter, nearest
            hit = (enter < leave) & (enter > 0) & (enter < depth)
        for normal, side in itertools.product(range(3), (False, True)):
            face = hit & (normals == normal) & ((directions[..., normal] > 0) == side)
            if not face.any():
                continue
            ray, ahead = directions[face], distance[face]
            x, y = (
                (position[axis] + ray[:, axis] * ahead) * TEXTURE_PER_METRE
                for axis in range(3)
                if axis != normal
            )
            color[face] = sample(self.textures[number][2 * normal + side], x, y)
            depth[face] = ahead


def visible_part(box, rotation, position):
    """The rows and columns of the image that the box may cover, or None if it covers none."""
    corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    x, y, z = ((corners - position) @ rotation).T
    if z.max() <= 0:
        return None
    if z.min() <= 0.05:
        return np.s_[:, :]
    columns, rows = x / z * FOCAL + WIDTH / 2, y / z * FOCAL + HEIGHT / 2
    left, right = np.clip([columns.min(), columns.max() + 2], 0, WIDTH).astype(int)
    top, bottom = np.clip([rows.min(), rows.max() + 2], 0, HEIGHT).astype(int)
    return np.s_[top:bottom, left:right] if left < right and top < bottom else None


def sample(image, x, y):
    # `remap` takes no image of more than 32767 columns: give it rows of 640 points.
    rows = -(-len(x) // WIDTH)
    grid = np.zeros((2, rows * WIDTH), np.float32)
    grid[0, : len(x)], grid[1, : len(y)] = x, y
    grid = grid.reshape(2, rows, WIDTH)
    return cv2.remap(image, grid[0], grid[1], cv2.INTER_LINEAR).reshape(-1, 3)[: len(x)]


def texture(rng):
    """Coarse color fields with rectangles and letters, which have the corners that ORB detects."""
    coarse = rng.integers(0, 255, (16, 16, 3), dtype=np.uint8)
    image = cv2.resize(coarse, (TEXTURE, TEXTURE), interpolation=cv2.INTER_CUBIC)
    for _ in range(700):
        x, y = map(int, rng.integers(0, TEXTURE, 2))
        w, h = map(int, rng.integers(6, 70, 2))
        cv2.rectangle(image, (x, y), (x + w, y + h), random_color(rng), -1)
    for _ in range(300):
        x, y = map(int, rng.integers(0, TEXTURE, 2))
        letter, size = chr(65 + int(rng.integers(0, 26))), float(rng.uniform(0.5, 2))
        cv2.putText(image, letter, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, random_color(rng), 2)
    return image


def random_color(rng):
    return tuple(int(value) for value in rng.integers(0, 255, 3))


def camera_pose(step, steps):
    """The camera's axes as columns and its position, at `step` of `steps` around the room.

    The camera looks outwards from a circle of 1.2 m radius and bobs up and down.
    """
    angle = 2 * np.pi * step / steps
    circle = np.array([np.cos(angle), 0.0, np.sin(angle)])
    position = np.array([3.0, 1.5 + 0.1 * np.sin(3 * angle), 3.0]) + 1.2 * circle
    forward = circle + [0.0, 0.05 * np.sin(2 * angle), 0.0]
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], 1), position
