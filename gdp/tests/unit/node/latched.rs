//! Unit tests of `node::latched`.

use super::*;

#[test]
fn the_last_are_kept_and_sent_again_once_each() {
    let mut samples = LatchedSamples::new(3);
    let body = [0, 1, 2, 3, 4, 5];
    let drafts: Vec<_> = body.chunks(1).map(|body| Draft::new(Encoding::Bytes, body)).collect();
    samples.keep(10, 77, &drafts[..2]);
    samples.keep(12, 78, &drafts[2..]);
    assert!(samples.next_again().is_none());
    samples.again();
    let mut sent = Vec::new();
    while let Some(draft) = samples.next_again() {
        sent.push((draft.latched.unwrap().sequence, draft.body[0]));
        // Messages that are sent in between reach all readers directly.
        if sent.len() == 1 {
            samples.keep(20, 79, &drafts[..2]);
        }
    }
    assert_eq!(sent, [(13, 3), (15, 5)], "one gave way to newer ones");
    let mut none = LatchedSamples::new(0);
    none.keep(1, 1, &drafts);
    none.again();
    assert!(none.next_again().is_none() && none.samples.is_empty());
}

#[test]
fn each_origin_has_its_own_last_ones_until_it_is_forgotten() {
    let mut samples = LatchedSamples::new(2);
    let body = [0, 1, 2, 3, 4, 5];
    let drafts = |origin: &'static [u8], of: std::ops::Range<usize>| {
        body[of].chunks(1).map(|body| Draft { origin, ..Draft::new(Encoding::Bytes, body) }).collect::<Vec<_>>()
    };
    samples.keep(1, 7, &drafts(&[1], 0..1));
    samples.keep(2, 7, &drafts(&[2], 1..4));
    samples.keep(5, 7, &drafts(&[3], 4..5));
    samples.pin(Encoding::Json, b"old");
    samples.pin(Encoding::Json, b"new");
    let again = |samples: &mut LatchedSamples| {
        samples.again();
        let mut sent = Vec::new();
        while let Some(draft) = samples.next_again() {
            sent.push((draft.latched.map(|first| first.sequence), draft.body.to_vec()));
        }
        sent
    };
    let pinned = (None, b"new".to_vec());
    let sent = [pinned.clone(), (Some(1), vec![0]), (Some(3), vec![2]), (Some(4), vec![3]), (Some(5), vec![4])];
    assert_eq!(again(&mut samples), sent);
    samples.mention(Encoding::Json, b"once");
    assert_eq!(samples.next_again().map(|draft| draft.body.to_vec()), Some(b"once".to_vec()));
    samples.forget(&[2]);
    assert_eq!(again(&mut samples), [pinned, sent[1].clone(), sent[4].clone()]);
    assert!(!samples.has_again());
}

#[test]
fn of_an_origin_as_many_are_kept_as_was_said() {
    let mut samples = LatchedSamples::new(0);
    let of = |origin: &'static [u8]| Draft { origin, ..Draft::new(Encoding::Bytes, b"") };
    samples.limit(&[1], 2);
    samples.keep(1, 7, &[of(&[1]), of(&[2]), of(&[1]), of(&[1])]);
    let kept = |samples: &LatchedSamples| samples.samples.iter().map(|s| s.first.sequence).collect::<Vec<_>>();
    assert_eq!(kept(&samples), [3, 4], "the other origin latches nothing");
    samples.limit(&[1], 1);
    assert_eq!(kept(&samples), [4]);
    samples.forget(&[1]);
    samples.keep(5, 7, &[of(&[1])]);
    assert_eq!(kept(&samples), [] as [u64; 0]);
}

#[test]
fn origins_are_bounded() {
    let mut samples = LatchedSamples::new(3);
    for i in 0..MAX_ORIGINS as u64 + 9 {
        let origin = i.to_be_bytes();
        let draft = Draft { origin: &origin, ..Draft::new(Encoding::Bytes, b"") };
        samples.keep(2 * i, 7, &[draft, draft]);
    }
    assert_eq!((samples.counts.len(), samples.samples.len()), (MAX_ORIGINS, 2 * MAX_ORIGINS));
    assert_eq!(samples.samples[0].first.sequence, 18);
}
