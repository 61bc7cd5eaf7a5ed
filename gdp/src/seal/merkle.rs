//! The hash tree that lets one signature cover a batch of messages. Leaves are padded with zeros to a power of two, so
//! a leaf's position says at every level on which side its sibling is. Leaves and inner nodes are hashed with different
//! first bytes (see [`super::wire::leaf`]), so neither passes for the other, and nobody knows what hashes to zero.

use super::wire::MAX_DEPTH;
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

/// What is known of a tree whose root was found to be signed: the pairs of nodes on the way up of the leaf that was
/// verified last. The next leaf of the batch most often meets one of them after one hash, instead of one for every level.
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
    /// Whether `leaf` is in a signed tree, at `position` and with `path` (of at most [`MAX_DEPTH`]) beside its way up.
    /// `is_signed` is asked about the root if that is not the known one.
    pub fn verify<E>(
        &mut self,
        backend: Backend,
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
                // Below here the pairs are those of this leaf now; from here on they are the same.
                self.pairs[..level].copy_from_slice(&pairs[..level]);
                self.position = position;
                return Ok(());
            }
            *pair = if index % 2 == 0 { [hash, *sibling] } else { [*sibling, hash] };
            hash = node(backend, &pair[0], &pair[1]);
        }
        if self.root != Some(hash) {
            is_signed(&hash)?;
        }
        *self = Self { root: Some(hash), depth: path.len(), position, pairs };
        Ok(())
    }
}

fn node(backend: Backend, left: &[u8; 32], right: &[u8; 32]) -> [u8; 32] {
    backend.sha256(&[&[1], left, right])
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    const BACKEND: Backend = Backend::AwsLc;

    #[test]
    fn every_leaf_leads_to_the_root_and_nothing_else_does() {
        let mut tree = Tree::default();
        let mut path = Vec::new();
        for count in 1..=17u8 {
            let leaves: Vec<[u8; 32]> = (1..=count).map(|i| [i; 32]).collect();
            tree.build(BACKEND, &leaves);
            for (position, leaf) in leaves.iter().enumerate() {
                tree.path(position, &mut path);
                assert_eq!(path.len(), depth(leaves.len()));
                assert_eq!(root(*leaf, position, &path), tree.root(), "{position} of {count}");
                assert_ne!(root([99; 32], position, &path), tree.root());
                if count > 1 {
                    assert_ne!(root(*leaf, position ^ 1, &path), tree.root());
                }
            }
        }
    }

    #[test]
    fn a_lone_leaf_is_the_root() {
        let mut tree = Tree::default();
        tree.build(BACKEND, &[[7; 32]]);
        assert_eq!(tree.root(), [7; 32]);
    }

    /// In any order, of trees of any size, also mixed: what is remembered never changes the answer.
    #[test]
    fn a_leaf_is_taken_if_its_root_is_signed_whatever_came_before() {
        let mut random = Random(4);
        let mut known = SignedTree::default();
        let mut trees = Vec::new();
        for i in 0..40u64 {
            let leaves: Vec<[u8; 32]> =
                (0..1 + random.below(70)).map(|_| random.bytes(32).try_into().unwrap()).collect();
            let mut tree = Tree::default();
            tree.build(BACKEND, &leaves);
            // Every fourth is signed by nobody.
            trees.push((leaves, tree, i % 4 != 0));
        }
        let (mut path, mut at) = (Vec::new(), 0);
        for _ in 0..20_000 {
            if random.below(30) == 0 {
                at = random.below(trees.len() as u64) as usize;
            }
            let (leaves, tree, is_signed) = &trees[at];
            let position = random.below(leaves.len() as u64) as usize;
            tree.path(position, &mut path);
            let mut leaf = leaves[position];
            let changed = random.below(4) == 0;
            if changed {
                leaf[0] ^= 1;
            }
            let signed = |root: &[u8; 32]| if *is_signed && *root == tree.root() { Ok(()) } else { Err(()) };
            let verdict = known.verify(BACKEND, leaf, position as u16, &path, signed);
            assert_eq!(verdict.is_ok(), *is_signed && !changed);
        }
    }

    fn root(leaf: [u8; 32], position: usize, path: &[[u8; 32]]) -> [u8; 32] {
        let mut root = leaf;
        let note = |found: &[u8; 32]| -> Result<(), ()> {
            root = *found;
            Ok(())
        };
        SignedTree::default().verify(BACKEND, leaf, position as u16, path, note).unwrap();
        root
    }
}
