//! The hash tree that lets one signature cover a batch of messages. Leaves are padded with zeros to a power of two, so
//! a leaf's position says at every level on which side its sibling is. Leaves and inner nodes are hashed with different
//! first bytes (see [`super::wire::leaf`]), so neither passes for the other, and nobody knows what hashes to zero.

use crate::crypto::Backend;

const PADDING: [u8; 32] = [0; 32];

/// A tree over a batch, kept to be reused. One message alone is a tree of depth 0, whose root is the leaf.
#[derive(Debug, Default)]
pub struct Tree {
    /// All levels one after another, leaves first.
    nodes: Vec<[u8; 32]>,
    depth: usize,
}

/// Levels between `count` leaves and their root.
pub fn depth(count: usize) -> usize {
    count.next_power_of_two().trailing_zeros() as usize
}

impl Tree {
    pub fn build(&mut self, backend: Backend, leaves: &[[u8; 32]]) {
        self.depth = depth(leaves.len());
        self.nodes.clear();
        self.nodes.extend_from_slice(leaves);
        self.nodes.resize(1 << self.depth, PADDING);
        let mut below = 0;
        for level in (0..self.depth).rev() {
            let start = self.nodes.len();
            for i in 0..1 << level {
                let node = node(backend, &self.nodes[below + 2 * i], &self.nodes[below + 2 * i + 1]);
                self.nodes.push(node);
            }
            below = start;
        }
    }

    pub fn root(&self) -> [u8; 32] {
        self.nodes.last().copied().unwrap_or(PADDING)
    }

    /// The siblings on the way from the leaf at `position` to the root.
    pub fn path(&self, position: usize, path: &mut Vec<[u8; 32]>) {
        path.clear();
        let mut level_start = 0;
        for level in 0..self.depth {
            path.push(self.nodes[level_start + (position >> level ^ 1)]);
            level_start += 1 << (self.depth - level);
        }
    }
}

/// The root of the tree that has `leaf` at `position` and `path` beside its way up.
pub fn root(backend: Backend, leaf: [u8; 32], position: u16, path: &[[u8; 32]]) -> [u8; 32] {
    path.iter().enumerate().fold(leaf, |hash, (level, sibling)| {
        if position >> level & 1 == 0 { node(backend, &hash, sibling) } else { node(backend, sibling, &hash) }
    })
}

fn node(backend: Backend, left: &[u8; 32], right: &[u8; 32]) -> [u8; 32] {
    backend.sha256(&[&[1], left, right])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_leaf_leads_to_the_root_and_nothing_else_does() {
        let backend = Backend::default();
        let mut tree = Tree::default();
        let mut path = Vec::new();
        for count in 1..=17u8 {
            let leaves: Vec<[u8; 32]> = (1..=count).map(|i| [i; 32]).collect();
            tree.build(backend, &leaves);
            for (position, leaf) in leaves.iter().enumerate() {
                tree.path(position, &mut path);
                assert_eq!(path.len(), depth(leaves.len()));
                assert_eq!(root(backend, *leaf, position as u16, &path), tree.root(), "{position} of {count}");
                assert_ne!(root(backend, [99; 32], position as u16, &path), tree.root());
                if count > 1 {
                    assert_ne!(root(backend, *leaf, position as u16 ^ 1, &path), tree.root());
                }
            }
        }
    }

    #[test]
    fn a_lone_leaf_is_the_root() {
        let mut tree = Tree::default();
        tree.build(Backend::default(), &[[7; 32]]);
        assert_eq!(tree.root(), [7; 32]);
    }
}
