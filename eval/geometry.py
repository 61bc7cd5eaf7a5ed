"""Conversions between rotation matrices and the quaternions x, y, z, w of ROS."""

import numpy as np


def quaternion(rotation):
    """Of a 3 x 3 rotation matrix; the sign is such that the largest component is positive."""
    m = np.asarray(rotation, float)
    # The eigenvector of the largest eigenvalue (Bar-Itzhack), which has no singular cases.
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    # `eigh` reads the lower triangle and sorts by eigenvalue.
    q = np.linalg.eigh(k)[1][:, -1]
    return q * np.sign(q[np.abs(q).argmax()])
