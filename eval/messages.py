"""The ROS messages of the workloads.

A request and its reply have the same `header.stamp`: `sec` is the request's number, `nanosec` is 0.
`decode` returns the message and its encoded content, over which the caller computes the digest.
"""

from dataclasses import dataclass

import numpy as np

import idl
from cdr import Decoder, Encoder, MessageError

#: The request number of a warm-up request.
WARM_UP = -1
#: Pixel type and channels of the image encodings in use (sensor_msgs/image_encodings.hpp).
ENCODINGS = {
    "rgb8": (np.dtype("u1"), 3),
    "mono8": (np.dtype("u1"), 1),
    "16UC1": (np.dtype("<u2"), 1),
    "32FC1": (np.dtype("<f4"), 1),
}


@dataclass
class Image:
    """A sensor_msgs/Image. `pixels` is [height, width] or [height, width, 3]."""

    IDL = idl.Image_
    number: int
    frame: str
    encoding: str
    pixels: np.ndarray

    def encode(self):
        kind, channels = ENCODINGS[self.encoding]
        pixels = np.asarray(self.pixels, kind)
        height, width = pixels.shape[:2]
        out = Encoder()
        out.stamped(self.number, self.frame)
        out.put("I", height, width)
        out.string(self.encoding)
        out.put("B", 0)
        out.put("I", width * channels * kind.itemsize, pixels.nbytes)
        out.array(pixels.reshape(-1).view("u1"))
        return out.finish()

    @classmethod
    def decode(cls, payload):
        data = Decoder("sensor_msgs/Image", payload)
        number, frame = data.stamped()
        height, width, encoding = data.get("I"), data.get("I"), data.string()
        big_endian, step, length = data.get("B"), data.get("I"), data.get("I")
        if encoding not in ENCODINGS or big_endian:
            raise MessageError(f"{data.name}: encoding {encoding!r}, big endian {big_endian}")
        kind, channels = ENCODINGS[encoding]
        if step != width * channels * kind.itemsize or length != height * step:
            raise MessageError(f"{data.name}: {length} bytes for {height} rows of {step} bytes")
        pixels = data.array("u1", length).view(kind)
        shape = (height, width, channels) if channels > 1 else (height, width)
        return cls(number, frame, encoding, pixels.reshape(shape)), data.content()


@dataclass
class PoseStamped:
    """A geometry_msgs/PoseStamped. `pose` is x, y, z and the quaternion x, y, z, w."""

    IDL = idl.PoseStamped_
    number: int
    frame: str
    pose: np.ndarray

    def encode(self):
        out = Encoder()
        self.append(out)
        return out.finish()

    def append(self, out):
        out.stamped(self.number, self.frame)
        out.array(np.asarray(self.pose, "<f8"))

    @classmethod
    def decode(cls, payload):
        data = Decoder("geometry_msgs/PoseStamped", payload)
        return cls.extract(data), data.content()

    @classmethod
    def extract(cls, data):
        number, frame = data.stamped()
        return cls(number, frame, data.array("<f8", 7))


@dataclass
class PoseArray:
    """A geometry_msgs/PoseArray. `poses` is [count, 7], each as in `PoseStamped`."""

    IDL = idl.PoseArray_
    number: int
    frame: str
    poses: np.ndarray

    def encode(self):
        poses = np.asarray(self.poses, "<f8").reshape(-1, 7)
        out = Encoder()
        out.stamped(self.number, self.frame)
        out.put("I", len(poses))
        if len(poses):
            out.array(poses)
        return out.finish()

    @classmethod
    def decode(cls, payload):
        data = Decoder("geometry_msgs/PoseArray", payload)
        number, frame = data.stamped()
        poses = data.array("<f8", data.get("I") * 7).reshape(-1, 7)
        return cls(number, frame, poses), data.content()


@dataclass
class Path:
    """A nav_msgs/Path. `poses` is [count, 7], each as in `PoseStamped`."""

    IDL = idl.Path_
    number: int
    frame: str
    poses: np.ndarray

    def encode(self):
        out = Encoder()
        out.stamped(self.number, self.frame)
        out.put("I", len(self.poses))
        for pose in self.poses:
            PoseStamped(self.number, self.frame, pose).append(out)
        return out.finish()

    @classmethod
    def decode(cls, payload):
        data = Decoder("nav_msgs/Path", payload)
        number, frame = data.stamped()
        poses = [PoseStamped.extract(data).pose for _ in range(data.get("I"))]
        return cls(number, frame, np.array(poses).reshape(-1, 7)), data.content()


@dataclass
class Marker:
    """A visualization_msgs/Marker of type TRIANGLE_LIST, visible in RViz.

    `points` is [3 * triangles, 3] in metres. `seed` is the marker's `id`, `start` its `pose`.
    """

    IDL = idl.Marker_
    TRIANGLE_LIST = 11
    number: int
    frame: str
    seed: int
    start: np.ndarray
    points: np.ndarray

    def encode(self):
        out = Encoder()
        out.stamped(self.number, self.frame)
        out.string("scene")
        out.put("i", self.seed, self.TRIANGLE_LIST, 0)
        out.array(np.asarray(self.start, "<f8"))
        out.put("d", 1.0, 1.0, 1.0)
        out.put("f", 0.7, 0.7, 0.7, 1.0)
        out.put("i", 0, 0)
        out.put("B", 0)
        out.put("I", len(self.points))
        out.array(np.asarray(self.points, "<f8"))
        # No colors per vertex, no texture: resource, image header, format, data, coordinates.
        out.put("I", 0)
        out.string("")
        out.stamped(0, "")
        out.string("")
        out.put("I", 0, 0)
        # No text and no mesh: text, resource, file name, data, embedded materials.
        for _ in range(3):
            out.string("")
        out.put("I", 0)
        out.put("B", 0)
        return out.finish()

    @classmethod
    def decode(cls, payload):
        data = Decoder("visualization_msgs/Marker", payload)
        number, frame = data.stamped()
        data.string()
        seed, kind, _ = data.get("i"), data.get("i"), data.get("i")
        if kind != cls.TRIANGLE_LIST:
            raise MessageError(f"{data.name}: type {kind}, expected TRIANGLE_LIST")
        start = data.array("<f8", 7)
        data.array("<f8", 3), data.array("<f4", 4), data.array("<i4", 2), data.get("B")
        points = data.array("<f8", 3 * data.get("I")).reshape(-1, 3)
        if len(points) % 3 or not np.isfinite(points).all():
            raise MessageError(f"{data.name}: {len(points)} points are not finite triangles")
        # The rest of the marker is decoded for its length only.
        data.array("<f4", 4 * data.get("I"))
        data.string(), data.stamped(), data.string()
        data.raw(data.get("I")), data.array("<f4", 2 * data.get("I"))
        for _ in range(3):
            data.string()
        data.raw(data.get("I")), data.get("B")
        return cls(number, frame, seed, start, points), data.content()
