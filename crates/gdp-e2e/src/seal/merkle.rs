//! The hash tree that lets one signature cover a batch of messages. Leaves are padded with zeros to
//! a power of two, so a leaf's position determines the side of its sibling at every level. Leaves
//! and inner nodes are hashed with different first bytes (see [`super::wire::leaf`]). A leaf
//! therefore cannot pass for an inner node, and no known input hashes to zero.

use super::wire::MAX_DEPTH;
use gdp_core::crypto;

const PADDING: [u8; 32] = [0; 32];

/// A reusable tree over a batch. A single message is a tree of depth 0, whose root is the leaf.
#[derive(Debug, Default)]
pub struct Tree {
    /// All levels concatenated, leaves first.
    nodes: Vec<[u8; 32]>,
    depth: usize,
}

/// Returns the number of levels between `count` leaves and their root.
pub fn depth(count: usize) -> usize {
    count.next_power_of_two().trailing_zeros() as usize
}

impl Tree {
    pub fn build(&mut self, leaves: &[[u8; 32]]) {
        self.depth = depth(leaves.len());
        self.nodes.clear();
        self.nodes.extend_from_slice(leaves);
        self.nodes.resize(1 << self.depth, PADDING);
        let mut below = 0;
        for level in (0..self.depth).rev() {
            let start = self.nodes.len();
            for i in 0..1 << level {
                let node = node(&self.nodes[below + 2 * i], &self.nodes[below + 2 * i + 1]);
                self.nodes.push(node);
            }
            below = start;
        }
    }

    pub fn root(&self) -> [u8; 32] {
        self.nodes.last().copied().unwrap_or(PADDING)
    }

    /// Writes the siblings on the path from the leaf at `position` to the root.
    pub fn path(&self, position: usize, path: &mut Vec<[u8; 32]>) {
        path.clear();
        let mut level_start = 0;
        for level in 0..self.depth {
            path.push(self.nodes[level_start + (position >> level ^ 1)]);
            level_start += 1 << (self.depth - level);
        }
    }
}

/// The verified part of a tree with a signed root: the pairs of nodes on the path of the last
/// verified leaf. The next leaf of the batch usually meets one of them after one hash, instead of
/// one hash per level.
#[derive(Debug)]
pub struct SignedTree {
    root: Option<[u8; 32]>,
    depth: usize,
    position: usize,
    pairs: [Pair; MAX_DEPTH],
}

type Pair = [[u8; 32]; 2];

impl Default for SignedTree {
    fn default() -> Self {
        Self { root: None, depth: 0, position: 0, pairs: [[PADDING; 2]; MAX_DEPTH] }
    }
}

impl SignedTree {
    /// Verifies that `leaf` is in a signed tree, at `position` and with the siblings in `path` (at
    /// most [`MAX_DEPTH`]). Calls `is_signed` for the root unless the root is the known one.
    pub fn verify<E>(
        &mut self,
        leaf: [u8; 32],
        position: u16,
        path: &[[u8; 32]],
        is_signed: impl FnOnce(&[u8; 32]) -> Result<(), E>,
    ) -> Result<(), E> {
        let position = usize::from(position);
        let same_shape = self.root.is_some() && self.depth == path.len();
        let mut pairs = [[PADDING; 2]; MAX_DEPTH];
        let mut hash = leaf;
        for (level, (sibling, pair)) in path.iter().zip(&mut pairs).enumerate() {
            let index = position >> level;
            let is_known_pair = same_shape && (self.position >> level) / 2 == index / 2;
            if is_known_pair && self.pairs[level][index % 2] == hash {
                // The pairs below this level are now those of this leaf; from this level on they
                // are unchanged.
                self.pairs[..level].copy_from_slice(&pairs[..level]);
                self.position = position;
                return Ok(());
            }
            *pair = if index % 2 == 0 { [hash, *sibling] } else { [*sibling, hash] };
            hash = node(&pair[0], &pair[1]);
        }
        if self.root != Some(hash) {
            is_signed(&hash)?;
        }
        *self = Self { root: Some(hash), depth: path.len(), position, pairs };
        Ok(())
    }
}

fn node(left: &[u8; 32], right: &[u8; 32]) -> [u8; 32] {
    crypto::sha256(&[&[1], left, right])
}

#[cfg(test)]
#[path = "../../tests/unit/seal/merkle.rs"]
mod tests;
