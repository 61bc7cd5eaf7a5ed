//! Unit tests of `seal::merkle`.

use super::*;
use gdp_faults::Random;

#[test]
fn every_leaf_leads_to_the_root_and_nothing_else_does() {
    let mut tree = Tree::default();
    let mut path = Vec::new();
    for count in 1..=17u8 {
        let leaves: Vec<[u8; 32]> = (1..=count).map(|i| [i; 32]).collect();
        tree.build(&leaves);
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
    tree.build(&[[7; 32]]);
    assert_eq!(tree.root(), [7; 32]);
}

/// For any order and any mixture of trees of any size, the cached pairs never change the result.
#[test]
fn a_leaf_is_taken_if_its_root_is_signed_whatever_came_before() {
    let mut random = Random::new(4);
    let mut known = SignedTree::default();
    let mut trees = Vec::new();
    for i in 0..40u64 {
        let leaves: Vec<[u8; 32]> = (0..1 + random.below(70)).map(|_| random.bytes(32).try_into().unwrap()).collect();
        let mut tree = Tree::default();
        tree.build(&leaves);
        // Every fourth tree is unsigned.
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
        let verdict = known.verify(leaf, position as u16, &path, signed);
        assert_eq!(verdict.is_ok(), *is_signed && !changed);
    }
}

fn root(leaf: [u8; 32], position: usize, path: &[[u8; 32]]) -> [u8; 32] {
    let mut root = leaf;
    let note = |found: &[u8; 32]| -> Result<(), ()> {
        root = *found;
        Ok(())
    };
    SignedTree::default().verify(leaf, position as u16, path, note).unwrap();
    root
}
