//! Unit tests of `cli::topology::layout`.

use super::*;

#[test]
fn a_ring_is_a_ring() {
    let edges: Vec<_> = (0..5).map(|i| (i, (i + 1) % 5)).collect();
    let boxes = placed(5, &edges);
    let middle = Rect::around(&boxes).unwrap();
    let radii: Vec<_> = boxes.iter().map(|b| (b.x - middle.x).hypot(b.y - middle.y)).collect();
    assert!(radii.iter().all(|r| (60.0..400.0).contains(r)), "{radii:?}");
}

#[test]
fn boxes_of_random_graphs_cover_neither_each_other_nor_their_labels() {
    let mut seed = 7u64;
    let mut random = |limit: usize| {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as usize % limit
    };
    for count in [1, 2, 3, 8, 20, 40] {
        // A tree, and some more; of the largest, two parts.
        let mut edges: Vec<_> = (1..count).filter(|i| *i != 30).map(|i| (random(i), i)).collect();
        for _ in 0..count / 3 {
            let (a, b) = (random(count), random(count));
            if a != b {
                edges.push((a, b));
            }
        }
        let boxes = placed(count, &edges);
        for (i, a) in boxes.iter().enumerate() {
            assert!(a.x.is_finite() && a.y.is_finite());
            assert!(boxes[i + 1..].iter().all(|b| !a.covers(b, 0.0)), "{count}: box {i} covers another");
        }
        assert_eq!(boxes, placed(count, &edges), "another picture of the same");
        let labels: Vec<_> = edges.iter().map(|(a, b)| on_line(&boxes[*a], &boxes[*b], (24.0, 14.0), &boxes)).collect();
        let covered = labels.iter().filter(|label| boxes.iter().any(|b| b.covers(label, 0.0))).count();
        assert_eq!(covered, 0, "{count}: of {} labels", labels.len());
    }
}

fn placed(count: usize, edges: &[(usize, usize)]) -> Vec<Rect> {
    let mut boxes = vec![Rect { width: 90.0, height: 44.0, ..Rect::default() }; count];
    place(&mut boxes, edges);
    boxes
}
