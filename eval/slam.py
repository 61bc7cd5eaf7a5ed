"""The `slam` workload: RGB-D frames at a fixed rate, and the camera's pose for each.

The edge runs ORB-SLAM3. Its mapping and loop closing run in threads of their own, so that two runs
agree to millimetres, not bit for bit.
"""

from pathlib import Path

import numpy as np

from geometry import quaternion
from messages import Image, PoseStamped

REQUESTS = {"/camera/color/image_raw": Image, "/camera/depth/image_raw": Image}
REPLY = ("/slam/pose", PoseStamped)
OPEN_LOOP = True
#: Frame of reference of a tracked pose. A reply without a frame says that tracking was lost.
TRACKED, LOST = "map", ""
#: Seconds between frames for ORB-SLAM3, whatever the robot's rate is.
FRAME_TIME = 0.1


class Robot:
    def __init__(self, options):
        data = Path(options.data)
        self.colors = np.load(data / "color.npy", mmap_mode="r")
        self.depths = np.load(data / "depth.npy", mmap_mode="r")
        self.positions = np.load(data / "positions.npy")
        self.frames = options.count

    def request(self, number):
        # The path is closed: after the last frame comes the first.
        step = max(number, 0) % len(self.colors)
        frame = "camera_color_optical_frame"
        return [
            Image(number, frame, "rgb8", self.colors[step]),
            Image(number, frame, "16UC1", self.depths[step]),
        ]

    def result(self, replies):
        tracked = sorted(n for n, reply in replies.items() if reply.frame == TRACKED)
        result = {"tracked": len(tracked), "frames": self.frames, "ate_m": None, "path_m": None}
        # Three points are the fewest that determine a rigid alignment.
        if len(tracked) >= 3:
            truth = self.positions[np.array(tracked) % len(self.positions)]
            estimate = np.array([replies[number].pose[:3] for number in tracked])
            result["ate_m"] = absolute_trajectory_error(estimate, truth)
            result["path_m"] = float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum())
        return result


class Edge:
    def __init__(self, options):
        # Only the edge's machine needs the library.
        import pyorbslam3

        data = Path(options.data)
        files = [str(data / name) for name in ("vocabulary.txt", "settings.yaml")]
        sensor = pyorbslam3.Sensor.RGBD
        self.slam = pyorbslam3.Slam(*files, sensor, use_viewer=False)

    def compute(self, color, depth):
        time = color.number * FRAME_TIME
        result = self.slam.track_rgbd(color.pixels, depth.pixels.astype(np.float32), time)
        if not result.pose_valid:
            return PoseStamped(color.number, LOST, np.zeros(7))
        pose = np.asarray(result.pose_wc)
        pose = np.concatenate([pose[:3, 3], quaternion(pose[:3, :3])])
        return PoseStamped(color.number, TRACKED, pose)

    def answer_warm_up(self, number):
        return PoseStamped(number, LOST, np.zeros(7))


def absolute_trajectory_error(estimate, truth):
    """Root mean square of the distances in metres, after rigid alignment.

    Method: Kabsch; metric: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems".
    """
    a, b = estimate - estimate.mean(0), truth - truth.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    aligned = a @ (vt.T @ mirror @ u.T).T
    return float(np.sqrt(((aligned - b) ** 2).sum(1).mean()))
