"""Makes a house of one floor with furniture, as triangles, for the `motion` workload.

The walls are always the same; the furniture of each scene is placed at random. Lengths are in
metres, z is up. The house is 12 m by 9 m and has six rooms.
"""

import numpy as np

WIDTH, DEPTH, HEIGHT = 12.0, 9.0, 2.6
WALL, DOOR, DOOR_HEIGHT = 0.12, 1.1, 2.1
#: Opposite corners of the rooms: two rows of three.
ROOMS = [(x, y, x + 4.0, y + 4.5) for y in (0.0, 4.5) for x in (0.0, 4.0, 8.0)]
#: Free floor at the middle of each room, where the robot starts and ends. Furniture keeps off.
FREE_RADIUS = 0.75
BOXES = 230
FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def house(rng):
    """Returns the triangles' corners, [3 * triangles, 3]."""
    boxes = walls()
    room = 0
    while len(boxes) < BOXES:
        boxes += furniture(ROOMS[room % len(ROOMS)], rng)
        room += 1
    return np.concatenate([triangles(*box) for box in boxes[:BOXES]])


def middle(room):
    x0, y0, x1, y1 = ROOMS[room]
    return np.array([(x0 + x1) / 2, (y0 + y1) / 2])


def walls():
    """Floor, ceiling, outer walls, and inner walls with a door into each next room."""
    half = WALL / 2
    boxes = [
        ([0, 0, -WALL], [WIDTH, DEPTH, 0]),
        ([0, 0, HEIGHT], [WIDTH, DEPTH, HEIGHT + WALL]),
        ([-half, 0, 0], [half, DEPTH, HEIGHT]),
        ([WIDTH - half, 0, 0], [WIDTH + half, DEPTH, HEIGHT]),
        ([0, -half, 0], [WIDTH, half, HEIGHT]),
        ([0, DEPTH - half, 0], [WIDTH, DEPTH + half, HEIGHT]),
    ]
    # Along y between columns of rooms; the doors are off the middle, on alternate sides.
    for x, door in ((4.0, 1.0), (8.0, 2.4), (4.0, 6.9), (8.0, 5.5)):
        start = 0.0 if door < 4.5 else 4.5
        boxes += wall_with_door([x - half, start], [x + half, start + 4.5], 1, door)
    # Along x between the rows of rooms; only the outer columns are connected.
    boxes += wall_with_door([0.0, 4.5 - half], [4.0, 4.5 + half], 0, 1.5)
    boxes.append(([4.0, 4.5 - half, 0], [8.0, 4.5 + half, HEIGHT]))
    boxes += wall_with_door([8.0, 4.5 - half], [12.0, 4.5 + half], 0, 9.5)
    return boxes


def wall_with_door(low, high, axis, door):
    """Splits a wall along `axis` into both sides of a door and the lintel above it."""
    sides = []
    for start, end, bottom in (
        (low[axis], door, 0.0),
        (door, door + DOOR, DOOR_HEIGHT),
        (door + DOOR, high[axis], 0.0),
    ):
        a, b = list(low), list(high)
        a[axis], b[axis] = start, end
        sides.append(([*a, bottom], [*b, HEIGHT]))
    return sides


def furniture(room, rng):
    """One piece at a random place in the room: a table, a chair, a shelf, or a hanging lamp."""
    x0, y0, x1, y1 = room
    width, depth = rng.uniform(0.35, 0.8, 2)
    while True:
        corner = rng.uniform([x0 + 0.1, y0 + 0.1], [x1 - 0.1 - width, y1 - 0.1 - depth])
        nearest = np.clip([(x0 + x1) / 2, (y0 + y1) / 2], corner, corner + [width, depth])
        if np.hypot(*(nearest - [(x0 + x1) / 2, (y0 + y1) / 2])) > FREE_RADIUS:
            break
    x, y = corner
    kind = rng.choice(["table", "chair", "shelf", "lamp"])
    if kind == "lamp":
        return [
            ([x + 0.15, y + 0.15, 2.0], [x + 0.17, y + 0.17, HEIGHT]),
            ([x, y, 1.85], [x + 0.32, y + 0.32, 2.0]),
        ]
    if kind == "shelf":
        boards = np.linspace(0.0, rng.uniform(0.8, 1.5), 5)
        sides = [([x, y, 0], [x + 0.03, y + depth, boards[-1]])]
        sides.append(([x + width - 0.03, y, 0], [x + width, y + depth, boards[-1]]))
        return sides + [([x, y, z], [x + width, y + depth, z + 0.03]) for z in boards]
    top = 0.75 if kind == "table" else 0.45
    legs = [
        ([x + a, y + b, 0], [x + a + 0.05, y + b + 0.05, top])
        for a in (0, width - 0.05)
        for b in (0, depth - 0.05)
    ]
    boxes = [*legs, ([x, y, top], [x + width, y + depth, top + 0.04])]
    if kind == "chair":
        boxes.append(([x, y, top], [x + 0.04, y + depth, 0.95]))
    return boxes


def triangles(low, high):
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    low, high = np.asarray(low, float), np.asarray(high, float)
    return (low + corners * (high - low))[FACES.reshape(-1)]
