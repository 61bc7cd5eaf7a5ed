"""Makes the data of the `slam` workload: camera sequence, vocabulary, settings.

The same version makes the same files. A second run finds the marker and does nothing.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import room
import vocabulary

#: Increase it when the data changes.
VERSION = 2
FRAMES = 240
#: Every eighth frame trains the vocabulary.
TRAINING_STEP = 8
TRAINING_FEATURES = 800

SETTINGS = f"""%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {room.FOCAL}
Camera1.fy: {room.FOCAL}
Camera1.cx: {room.WIDTH / 2}
Camera1.cy: {room.HEIGHT / 2}
Camera1.k1: 0.0
Camera1.k2: 0.0
Camera1.p1: 0.0
Camera1.p2: 0.0
Camera.width: {room.WIDTH}
Camera.height: {room.HEIGHT}
Camera.fps: 10
Camera.RGB: 1
Stereo.ThDepth: 40.0
Stereo.b: 0.07732
RGBD.DepthMapFactor: {room.DEPTH_FACTOR}
ORBextractor.nFeatures: 600
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    data = parser.parse_args().data
    marker = data / "version"
    if marker.exists() and marker.read_text() == f"{VERSION}\n":
        print(f"{data}: version {VERSION} is there")
        return
    data.mkdir(parents=True, exist_ok=True)
    marker.unlink(missing_ok=True)
    colors = render(data)
    with Step("vocabulary"):
        training = [np.asarray(image) for image in colors[::TRAINING_STEP]]
        text = vocabulary.train(training, np.random.default_rng(2), TRAINING_FEATURES)
        (data / "vocabulary.txt").write_text(text)
    (data / "settings.yaml").write_text(SETTINGS)
    # Last, so that an interrupted run starts again.
    marker.write_text(f"{VERSION}\n")


def render(data):
    """Writes color.npy [N, 480, 640, 3], depth.npy [N, 480, 640] and positions.npy [N, 3]."""
    with Step("textures"):
        scene = room.Room(np.random.default_rng(1))
    shape = (FRAMES, room.HEIGHT, room.WIDTH)
    create = np.lib.format.open_memmap
    colors = create(data / "color.npy", mode="w+", dtype=np.uint8, shape=(*shape, 3))
    depths = create(data / "depth.npy", mode="w+", dtype=np.uint16, shape=shape)
    poses = [room.camera_pose(step, FRAMES) for step in range(FRAMES)]
    noise = np.random.default_rng(5)
    with Step(f"{FRAMES} frames"):
        for step, (rotation, position) in enumerate(poses):
            colors[step], depths[step] = scene.render(rotation, position, noise)
        colors.flush()
        depths.flush()
    np.save(data / "positions.npy", np.array([position for _, position in poses]))
    return colors


class Step:
    """Prints what is being made, and how long it took."""

    def __init__(self, name):
        self.name = name

    def __enter__(self):
        print(self.name, end=" ... ", flush=True)
        self.start = time.monotonic()

    def __exit__(self, *_):
        print(f"{time.monotonic() - self.start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
