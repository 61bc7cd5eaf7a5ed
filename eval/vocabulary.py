"""Trains a visual vocabulary for ORB-SLAM3 by hierarchical k-means on ORB descriptors.

ORB-SLAM3 is distributed with a vocabulary of 145 MB. This one is trained on the room itself: it is
small, and nothing has to be downloaded.
"""

import cv2
import numpy as np

BRANCHES, LEVELS, ROUNDS = 10, 4, 5


def train(images, rng, features):
    """Returns the text of a DBoW2 vocabulary (weighting TF-IDF, scoring L1)."""
    orb = cv2.ORB_create(features)
    found = [orb.detectAndCompute(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), None)[1] for i in images]
    source = np.repeat(np.arange(len(found)), [len(descriptors) for descriptors in found])
    # A bit is +1 or -1, so that the largest scalar product is the smallest Hamming distance.
    bits = np.unpackbits(np.concatenate(found), axis=1).astype(np.float32) * 2 - 1
    tree = Tree(bits, source, len(images), rng)
    tree.split(np.arange(len(bits)), parent=0, level=1)
    return "".join([f"{BRANCHES} {LEVELS} 0 0\n", *tree.lines])


class Tree:
    def __init__(self, bits, source, images, rng):
        self.bits, self.source, self.images, self.rng = bits, source, images, rng
        self.lines = []

    def split(self, members, parent, level):
        """Appends the children of `parent`, whose descriptors are `members`, and all below them.

        The line number is a node's number, so that parents come before their children.
        """
        centers, nearest = self.cluster(members)
        inner = []
        for number, center in enumerate(centers):
            mine = members[nearest == number]
            if not len(mine):
                continue
            leaf = level == LEVELS or len(mine) <= BRANCHES
            self.lines.append(self.line(parent, leaf, center, mine))
            if not leaf:
                inner.append((mine, len(self.lines)))
        for mine, node in inner:
            self.split(mine, node, level + 1)

    def cluster(self, members):
        bits = self.bits[members]
        count = min(BRANCHES, len(members))
        centers = bits[self.rng.choice(len(bits), count, replace=False)]
        for _ in range(ROUNDS):
            nearest = (bits @ centers.T).argmax(1)
            for number in np.unique(nearest):
                sums = bits[nearest == number].sum(0)
                centers[number] = np.where(sums >= 0, 1, -1)
        return centers, (bits @ centers.T).argmax(1)

    def line(self, parent, leaf, center, mine):
        descriptor = " ".join(map(str, np.packbits(center > 0)))
        # The inverse document frequency; DBoW2 drops words of weight 0.
        weight = max(np.log(self.images / len(np.unique(self.source[mine]))), 1e-3) if leaf else 0
        return f"{parent} {int(leaf)} {descriptor} {weight:.6f}\n"
